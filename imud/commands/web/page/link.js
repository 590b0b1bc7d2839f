// The connection to `imud web`: messages as they come, and connecting again for ever.

const RETRY_MS = 1000;
const SILENCE_MS = 10000; // a dead network does not close a socket

// Returns what sends a text while there is a connection.
export function connect(onMessage, onLost) {
  let socket;
  (function open() { socket = openOnce(onMessage, () => { onLost(); setTimeout(open, RETRY_MS); }); })();
  return (text) => socket.readyState === WebSocket.OPEN && socket.send(text);
}

function openOnce(onMessage, onLost) {
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  let heard = performance.now();
  const watchdog = setInterval(() => performance.now() - heard > SILENCE_MS && lost(), 1000);
  let open = true;
  function lost() {
    if (!open) return;
    open = false;
    clearInterval(watchdog);
    socket.close();
    onLost();
  }
  socket.onmessage = (event) => {
    heard = performance.now();
    if (open) onMessage(JSON.parse(event.data));
  };
  socket.onclose = lost;
  return socket;
}
