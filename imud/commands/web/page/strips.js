// Strip charts of the last minute: which quantities, and their traces with +-1 sigma.

import { colour } from "./draw.js";
import { addPlot, axis } from "./plots.js";

const SPAN_S = 60;
const PERIOD_S = 0.1;
const NAMES = ["x", "y", "z"];

// keys: [source, value, sigma] of each curve; scale: from the message's unit to the chart's.
const STRIPS = [
  { title: "Roll and pitch", unit: "deg", names: ["roll", "pitch"], turns: true, keys: [["EST", "roll_deg", "sroll_deg"], ["EST", "pitch_deg", "spitch_deg"]] },
  { title: "Heading or yaw", unit: "deg", names: ["heading"], turns: true, keys: [["EST", "heading_deg", "syaw_deg"]] },
  { title: "Angular rate, body FRD", unit: "deg/s", keys: NAMES.map((a) => ["ATT", `gyro_${a}`]) },
  { title: "Specific force, body FRD", unit: "m/s²", keys: NAMES.map((a) => ["ATT", `acc_${a}`]) },
  { title: "Velocity, NED", unit: "m/s", names: ["north", "east", "down"], keys: [..."ned"].map((a) => ["EST", `v${a}_mps`, `sv${a}_mps`]) },
  { title: "Position 1σ, NED", unit: "m", names: ["north", "east", "down"], keys: [..."ned"].map((a) => ["EST", `s${a}_m`]) },
  { title: "Gyro bias", unit: "deg/s", keys: NAMES.map((a) => ["EST", `bg${a}_dps`, `sbg${a}_dps`]) },
  { title: "Accelerometer bias", unit: "m/s²", keys: NAMES.map((a) => ["EST", `ba${a}_mps2`, `sba${a}_mps2`]) },
];

let history = []; // of { t: s, ATT, EST }

export function remember(news) {
  const t = news.EST.t_mono_ns * 1e-9;
  const last = history.at(-1);
  if (last && t < last.t) history = []; // another machine, or it started again
  else if (last && t - last.t < PERIOD_S) return;
  history.push({ t, ATT: news.ATT ?? {}, EST: news.EST });
  while (history[0].t < t - SPAN_S) history.shift();
}

// One curve in pieces: it breaks where data are missing and where an angle passes its end.
function pieces([source, key, sigma], turns) {
  const now = history.at(-1)?.t ?? 0;
  const found = [];
  let before = null;
  for (const row of history) {
    const y = row[source][key];
    if (y == null) { before = null; continue; }
    if (!before || row.t - before.t > 1 || (turns && Math.abs(y - before.y) > 180)) found.push([]);
    before = { t: row.t, y };
    found.at(-1).push({ x: row.t - now, y, spread: row[source][sigma] ?? 0 });
  }
  return found;
}

// Coordinates of pieces, a break after each.
function joined(parts, points) {
  const all = parts.flatMap((part) => [...points(part), { x: null, y: null }]);
  return { x: all.map((p) => p.x), y: all.map((p) => p.y) };
}

function outline(part) {
  const side = (sign) => part.map(({ x, y, spread }) => ({ x, y: y + sign * spread }));
  return [...side(1), ...side(-1).reverse()];
}

function curve(strip, k) {
  const tint = colour(NAMES[strip.keys.length === 1 ? 2 : k]);
  const rgb = [1, 3, 5].map((i) => parseInt(tint.slice(i, i + 2), 16));
  const parts = pieces(strip.keys[k], strip.turns);
  const band = { fill: "toself", fillcolor: `rgba(${rgb},0.18)`, line: { width: 0 }, hoverinfo: "skip", showlegend: false };
  const middle = { name: (strip.names ?? NAMES)[k], showlegend: strip.keys.length > 1, line: { color: tint, width: 1.6 } };
  return [
    ...(strip.keys[k][2] ? [{ ...joined(parts, outline), mode: "lines", ...band }] : []),
    { ...joined(parts, (part) => part), mode: "lines", ...middle },
  ];
}

export function makeStrips(place) {
  for (const strip of STRIPS) {
    const section = place.appendChild(document.createElement("section"));
    const bands = strip.keys[0][2] ? ", ±1σ" : "";
    section.innerHTML = `<h2>${strip.title}${bands}</h2><div class="chart" role="img" aria-label="${strip.title}, the last minute, ${strip.unit}"></div>`;
    addPlot(section.lastChild, () => ({
      traces: strip.keys.flatMap((_, k) => curve(strip, k)),
      layout: { xaxis: axis("time before now, s", { range: [-SPAN_S, 0] }), yaxis: axis(strip.unit) },
    }));
  }
}
