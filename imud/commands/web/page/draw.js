// What all drawings share: a canvas that is sharp on every screen, and the page's colours.

export const DEG = Math.PI / 180;

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

// What a canvas shows, for those who do not see it: its name and a text.
export function describe(canvas, text) {
  const label = `${canvas.dataset.name}: ${text}`;
  if (canvas.getAttribute("aria-label") !== label) canvas.setAttribute("aria-label", label);
}

// The context of a canvas, cleared, in CSS pixels with the origin in the middle; and half its width and height.
export function begin(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const c = canvas.getContext("2d");
  c.setTransform(ratio, 0, 0, ratio, canvas.width / 2, canvas.height / 2);
  c.font = "12px system-ui, sans-serif";
  c.textAlign = "center";
  c.textBaseline = "middle";
  return { c, w: width / 2, h: height / 2 };
}

export function line(c, ...points) {
  c.beginPath();
  points.forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
  c.stroke();
}
