// The connection to `imud web`: messages as they come, and connecting again for ever.

const RETRY_MS = 1000;
const SILENCE_MS = 10000; // a dead network does not close a socket

export function connect(onMessage, onLost) {
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
    setTimeout(() => connect(onMessage, onLost), RETRY_MS);
  }
  socket.onmessage = (event) => {
    heard = performance.now();
    if (open) onMessage(JSON.parse(event.data));
  };
  socket.onclose = lost;
}
