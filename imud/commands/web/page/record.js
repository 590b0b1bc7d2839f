// The record button: what the daemon says of its recording, and the wish to begin or end one.

const button = document.getElementById("record"), said = document.getElementById("recorded");
let mayControl = false, recording = false;

export function permit(control) { mayControl = control; }

export function onRecord(send) {
  button.addEventListener("click", () => send(recording ? "stop" : "record"));
}

function size(bytes) {
  return bytes < 1e6 ? `${(bytes / 1e3).toFixed(0)} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
}

export function tellRecording(state) {
  recording = state?.recording ?? false;
  button.hidden = !(mayControl && state?.allowed);
  button.textContent = recording ? "■ stop recording" : "● record";
  button.className = recording ? "bad" : "";
  const file = state?.path ? `${state.path.split("/").at(-1)}, ${size(state.bytes)}` : "starting";
  said.textContent = [recording ? `recording: ${file}` : "", state?.trouble ?? ""].filter(Boolean).join("; ");
  said.className = state?.trouble ? "bad" : "";
  said.title = state?.path ?? "";
}
