// Artificial horizon and compass rose. Angles in degrees; undefined or null is unknown.

import { DEG, begin, colour, describe, line } from "./draw.js";

const PX_PER_DEG = 2.6;

function ladder(c, pitch) {
  c.strokeStyle = c.fillStyle = "#fff";
  c.lineWidth = 1.5;
  for (let mark = -90; mark <= 90; mark += 10) {
    const y = (pitch - mark) * PX_PER_DEG;
    const half = mark % 30 ? 20 : 34;
    if (mark) line(c, [-half, y], [half, y]);
    if (mark) for (const side of [-1, 1]) c.fillText(String(mark), side * (half + 16), y);
  }
}

function rollScale(c, radius, roll) {
  for (const mark of [-60, -45, -30, -20, -10, 0, 10, 20, 30, 45, 60]) {
    const a = (mark - 90) * DEG;
    const inner = radius - (mark % 30 ? 5 : 9);
    line(c, [radius * Math.cos(a), radius * Math.sin(a)], [inner * Math.cos(a), inner * Math.sin(a)]);
  }
  const a = (-roll - 90) * DEG; // the pointer stays with the sky
  const [x, y] = [Math.cos(a), Math.sin(a)];
  c.fillStyle = "#ffd84d";
  c.beginPath();
  c.moveTo((radius - 10) * x, (radius - 10) * y);
  for (const side of [-1, 1]) c.lineTo((radius - 20) * x - side * 6 * y, (radius - 20) * y + side * 6 * x);
  c.fill();
}

export function drawHorizon(canvas, roll, pitch) {
  const { c, w, h } = begin(canvas);
  describe(canvas, roll == null ? "unknown" : `roll ${Math.round(roll)}, pitch ${Math.round(pitch)} degrees`);
  if (roll == null || pitch == null) return unknown(c);
  const far = 3 * (w + h);
  c.save();
  c.rotate(-roll * DEG);
  c.fillStyle = "#2f78c4";
  c.fillRect(-far, -far, 2 * far, far + pitch * PX_PER_DEG);
  c.fillStyle = "#83592f";
  c.fillRect(-far, pitch * PX_PER_DEG, 2 * far, far);
  c.strokeStyle = "#fff";
  c.lineWidth = 2;
  line(c, [-far, pitch * PX_PER_DEG], [far, pitch * PX_PER_DEG]);
  c.beginPath();
  c.rect(-80, -(h - 38), 160, 2 * (h - 38));
  c.clip();
  ladder(c, pitch);
  c.restore();
  c.strokeStyle = "#fff";
  rollScale(c, h - 6, roll);
  c.strokeStyle = "#ffd84d";
  c.lineWidth = 4;
  for (const side of [-1, 1]) line(c, [side * 58, 0], [side * 24, 0], [side * 24, 9]);
  c.strokeRect(-1, -1, 2, 2);
}

export function drawCompass(canvas, yaw, sigma, isHeading) {
  const { c, w, h } = begin(canvas);
  describe(canvas, yaw == null ? "unknown" : `${Math.round(yaw)} degrees${isHeading ? " from true north" : ", north not known"}`);
  if (yaw == null) return unknown(c);
  const radius = Math.max(Math.min(w, h) - 14, 0); // before the page is laid out a canvas has no size
  const ink = colour("ink");
  c.save();
  c.rotate(-yaw * DEG);
  c.strokeStyle = colour("soft");
  for (let mark = 0; mark < 360; mark += 10) {
    c.save();
    c.rotate(mark * DEG);
    line(c, [0, -radius], [0, -radius + (mark % 30 ? 5 : 9)]);
    if (mark % 30 === 0) {
      c.translate(0, -radius + 20);
      c.fillStyle = mark === 0 && isHeading ? colour("x") : ink;
      c.fillText(isHeading && mark % 90 === 0 ? "NESW"[mark / 90] : String(mark), 0, 0);
    }
    c.restore();
  }
  c.restore();
  if (sigma != null) {
    const spread = Math.min(sigma, 180) * DEG;
    c.fillStyle = colour("z");
    c.globalAlpha = 0.25;
    c.beginPath();
    c.moveTo(0, 0);
    c.arc(0, 0, radius, -Math.PI / 2 - spread, -Math.PI / 2 + spread);
    c.fill();
    c.globalAlpha = 1;
  }
  c.fillStyle = colour("z");
  c.beginPath();
  c.moveTo(0, -radius - 3);
  c.lineTo(-7, -radius - 13);
  c.lineTo(7, -radius - 13);
  c.fill();
  c.fillStyle = ink;
  c.font = "600 28px system-ui, sans-serif";
  c.fillText(`${((Math.round(yaw) % 360) + 360) % 360}°`, 0, 0);
  c.font = "12px system-ui, sans-serif";
  c.fillText(isHeading ? "from true north" : "not from north", 0, 24);
}

export function unknown(c) {
  c.fillStyle = colour("soft");
  c.fillText("not known", 0, 0);
}
