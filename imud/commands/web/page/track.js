// The track on a metric grid: metres north and east of the first position, with the ellipse that holds 95 %. The line is
// broken where nothing moved so: after a gap, or where a fix has corrected an estimate that had coasted.

import { DEG, colour } from "./draw.js";
import { addPlot, axis } from "./plots.js";

const A = 6378137.0, E2 = 0.00669437999014; // WGS-84: m, first eccentricity squared
const RADIUS_95 = Math.sqrt(-2 * Math.log(0.05)); // of a plane normal distribution, in sigmas
const LEAST_S = 0.2;
const MOST = 4000; // points; then every second one goes
const LEAST_HALF_M = 5; // of the map
const GAP_S = 3; // a receiver of one fix per second may be late
const JUMP_M = 5; // beyond twice what the speed explains

let origin = null, north = [], east = [], last = null, stride = LEAST_S;

export function forgetTrack() {
  [origin, north, east, last, stride] = [null, [], [], null, LEAST_S];
}

export function follow(est) {
  if (est.lat_deg == null) { last = null; return; }
  const t = est.t_mono_ns * 1e-9;
  origin ??= { lat: est.lat_deg, lon: est.lon_deg, t };
  const s = Math.sin(origin.lat * DEG), d = 1 - E2 * s * s;
  const n = (est.lat_deg - origin.lat) * DEG * A * (1 - E2) / d ** 1.5;
  const turn = ((est.lon_deg - origin.lon + 540) % 360) - 180;
  const e = turn * DEG * (A / Math.sqrt(d)) * Math.cos(origin.lat * DEG);
  const moved = joined(last, t, n, e, Math.hypot(est.vn_mps ?? 0, est.ve_mps ?? 0));
  last = { t, n, e, sn: est.sn_m, se: est.se_m, yaw: est.state.includes("heading") ? est.yaw_deg : null };
  if (moved && Math.abs(t - origin.t) < stride) return;
  origin.t = t;
  if (!moved && north.length) add(null, null);
  add(n, e);
  if (north.length > MOST) {
    const every = (x, i) => i % 2 === 0 || x === null;
    [north, east, stride] = [north.filter(every), east.filter(every), 2 * stride];
  }
}

function add(n, e) {
  north.push(n);
  east.push(e);
}

// Whether it can have moved from there to here.
function joined(from, t, n, e, speed) {
  if (!from || Math.abs(t - from.t) > GAP_S) return false;
  return Math.hypot(n - from.n, e - from.e) < JUMP_M + 2 * speed * Math.abs(t - from.t);
}

function ellipse({ n, e, sn, se }) {
  const turns = Array.from({ length: 49 }, (_, i) => (i * Math.PI) / 24);
  return { x: turns.map((a) => e + RADIUS_95 * se * Math.sin(a)), y: turns.map((a) => n + RADIUS_95 * sn * Math.cos(a)) };
}

function bounds(values, margin) {
  const low = Math.min(...values) - margin, high = Math.max(...values) + margin;
  const half = Math.max((high - low) * 0.55, LEAST_HALF_M), middle = (low + high) / 2;
  return [middle - half, middle + half];
}

export function makeTrack(element) {
  addPlot(element, () => {
    const here = last ? [last] : [];
    const spread = last ? RADIUS_95 * Math.max(last.sn, last.se) : 0;
    const tint = colour("z");
    const rgb = [1, 3, 5].map((i) => parseInt(tint.slice(i, i + 2), 16));
    const marker = { color: colour("x"), size: 13, symbol: last?.yaw == null ? "circle" : "arrow", angle: last?.yaw ?? 0 };
    const xs = [...east, ...here.map((p) => p.e)], ys = [...north, ...here.map((p) => p.n)];
    return {
      traces: [
        { x: xs, y: ys, mode: "lines", name: "track", line: { color: tint, width: 2 } },
        { ...(last ? ellipse(last) : { x: [], y: [] }), mode: "lines", fill: "toself", name: "95 %", line: { color: tint, width: 1, dash: "dot" }, fillcolor: `rgba(${rgb},0.18)`, hoverinfo: "skip" },
        { x: here.map((p) => p.e), y: here.map((p) => p.n), mode: "markers", name: "now", marker },
      ],
      layout: {
        xaxis: axis("east, m", { range: xs.length ? bounds(xs, spread) : [-LEAST_HALF_M, LEAST_HALF_M] }),
        yaxis: axis("north, m", { range: ys.length ? bounds(ys, spread) : [-LEAST_HALF_M, LEAST_HALF_M], scaleanchor: "x", scaleratio: 1 }),
      },
    };
  });
}
