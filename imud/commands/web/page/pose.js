// The body in the navigation frame, seen from outside: a box with its axes over the ground's north and east.

import { DEG, begin, colour, line } from "./draw.js";
import { unknown } from "./horizon.js";

const view = { azimuth: 30, elevation: 25 }; // deg, from where the eye looks
const SIZE = [1.0, 0.6, 0.22]; // half edges of the box: forward, right, down
const FACES = [[0, 1], [0, -1], [1, 1], [1, -1], [2, 1], [2, -1]]; // axis, side

const TURNS = { ArrowLeft: [-10, 0], ArrowRight: [10, 0], ArrowUp: [0, -10], ArrowDown: [0, 10] }; // degrees

export function turnView(canvas, redraw) {
  let from = null;
  const turn = (azimuth, elevation) => {
    view.azimuth += azimuth;
    view.elevation = Math.min(89, Math.max(-30, view.elevation + elevation));
    redraw();
  };
  canvas.addEventListener("pointerdown", (e) => { from = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
  canvas.addEventListener("pointermove", (e) => {
    if (!from) return;
    turn((e.clientX - from[0]) * 0.5, (e.clientY - from[1]) * 0.5);
    from = [e.clientX, e.clientY];
  });
  canvas.addEventListener("keydown", (e) => {
    const [azimuth, elevation] = TURNS[e.key] ?? [0, 0];
    if (!azimuth && !elevation) return;
    e.preventDefault(); // of scrolling
    turn(azimuth, elevation);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { from = null; });
}

// Body (FRD) to NED by the Hamilton quaternion q, scalar first.
export function rotate([w, x, y, z], [a, b, c]) {
  return [
    (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c,
    2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c,
    2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c,
  ];
}

// NED to [right, down, away] of an eye that looks towards `azimuth`, down by `elevation`.
function seen([n, e, d]) {
  const a = view.azimuth * DEG, b = view.elevation * DEG;
  const along = n * Math.cos(a) + e * Math.sin(a), right = e * Math.cos(a) - n * Math.sin(a);
  return [right, d * Math.cos(b) - along * Math.sin(b), along * Math.cos(b) + d * Math.sin(b)];
}

function arrow(c, scale, tip, text, tint) {
  const [x, y] = seen(tip).map((v) => v * scale);
  c.strokeStyle = c.fillStyle = tint;
  c.lineWidth = 2.5;
  line(c, [0, 0], [x, y]);
  c.fillText(text, x * 1.1, y * 1.1);
}

function ground(c, scale, isNorthKnown) {
  c.strokeStyle = colour("line");
  c.lineWidth = 1;
  const at = (n, e) => seen([n, e, 1]).slice(0, 2).map((v) => v * scale);
  for (let k = -2; k <= 2; k += 1) {
    line(c, at(k, -2), at(k, 2));
    line(c, at(-2, k), at(2, k));
  }
  c.fillStyle = colour("soft");
  if (!isNorthKnown) return;
  for (const [text, n, e] of [["N", 2.25, 0], ["E", 0, 2.25], ["S", -2.25, 0], ["W", 0, -2.25]]) c.fillText(text, ...at(n, e));
}

function box(c, scale, q) {
  const faces = FACES.map(([axis, side]) => {
    const [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
    const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([s, t]) => {
      const p = [0, 0, 0];
      p[axis] = side * SIZE[axis];
      p[u] = s * SIZE[u];
      p[v] = t * SIZE[v];
      return seen(rotate(q, p));
    });
    return { axis, side, corners, away: corners.reduce((sum, p) => sum + p[2], 0) };
  }).sort((p, r) => r.away - p.away);
  c.strokeStyle = colour("ink");
  c.lineWidth = 1;
  for (const { axis, side, corners } of faces) {
    c.fillStyle = axis === 0 && side > 0 ? colour("x") : colour("line");
    c.globalAlpha = 0.85;
    c.beginPath();
    corners.forEach(([x, y], i) => (i ? c.lineTo(x * scale, y * scale) : c.moveTo(x * scale, y * scale)));
    c.closePath();
    c.fill();
    c.globalAlpha = 1;
    c.stroke();
  }
}

export function drawPose(canvas, q, isNorthKnown) {
  const { c, w, h } = begin(canvas);
  if (!q) return unknown(c);
  const scale = Math.min(w / 2.8, h / 2);
  c.translate(0, -0.3 * scale);
  ground(c, scale, isNorthKnown);
  box(c, scale, q);
  [["x", [1.7, 0, 0]], ["y", [0, 1.3, 0]], ["z", [0, 0, 1]]].forEach(([name, tip]) => arrow(c, scale, rotate(q, tip), name, colour(name)));
}
