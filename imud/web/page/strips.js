// Strip charts of the last minute: which quantities, and their traces with +-1 sigma.

import { colour } from "./draw.js";
import { addPlot, axis } from "./plots.js";

const SPAN_S = 60;
const PERIOD_S = 0.1;
const NAMES = ["x", "y", "z"];

// keys: [source, value, sigma] of each curve; scale: from the message's unit to the chart's.
const STRIPS = [
  { title: "Roll and pitch", unit: "deg", names: ["roll", "pitch"], keys: [["EST", "roll_deg", "sroll_deg"], ["EST", "pitch_deg", "spitch_deg"]] },
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

// Columns of one curve; a break of the line (null) where data are missing or the heading passes north.
function columns([source, key, sigma], turns) {
  const now = history.at(-1)?.t ?? 0;
  const x = [], y = [], low = [], high = [];
  let before = null;
  for (const row of history) {
    const value = row[source][key] ?? null, spread = row[source][sigma] ?? null;
    if (before && (row.t - before.t > 1 || (turns && Math.abs(value - before.value) > 180))) {
      x.push(null); y.push(null); low.push(null); high.push(null);
    }
    x.push(row.t - now);
    y.push(value);
    low.push(value == null || spread == null ? null : value - spread);
    high.push(value == null || spread == null ? null : value + spread);
    before = { t: row.t, value };
  }
  return { x, y, low, high };
}

function curve(strip, k) {
  const tint = colour(NAMES[strip.keys.length === 1 ? 2 : k]);
  const { x, y, low, high } = columns(strip.keys[k], strip.turns);
  const shared = { x, mode: "lines", hoverinfo: "skip", showlegend: false, line: { width: 0, color: tint } };
  const rgb = [1, 3, 5].map((i) => parseInt(tint.slice(i, i + 2), 16));
  const band = strip.keys[k][2] ? [{ ...shared, y: low }, { ...shared, y: high, fill: "tonexty", fillcolor: `rgba(${rgb},0.18)` }] : [];
  return [...band, { x, y, mode: "lines", name: (strip.names ?? NAMES)[k], showlegend: strip.keys.length > 1, line: { color: tint, width: 1.6 } }];
}

export function makeStrips(place) {
  for (const strip of STRIPS) {
    const section = place.appendChild(document.createElement("section"));
    const bands = strip.keys[0][2] ? ", ±1σ" : "";
    section.innerHTML = `<h2>${strip.title}${bands}</h2><div class="chart"></div>`;
    addPlot(section.lastChild, () => ({
      traces: strip.keys.flatMap((_, k) => curve(strip, k)),
      layout: { xaxis: axis("time before now, s", { range: [-SPAN_S, 0] }), yaxis: axis(strip.unit) },
    }));
  }
}
