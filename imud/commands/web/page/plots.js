// Plotly in the page's colours, drawn in turn: each plot that is on the screen, as often as leaves the page responsive.

import { colour } from "./draw.js";

const CONFIG = { responsive: true, displaylogo: false, displayModeBar: false };
const MIN_PAUSE_MS = 120;
const SHARE = 2; // pause at least so many times what drawing took

const plots = [];

// draw(layout): traces, and the layout's own keys, of one plot in `element`.
export function addPlot(element, draw) {
  const plot = { element, draw, visible: false, drawn: false };
  plots.push(plot);
  new IntersectionObserver((entries) => { plot.visible = entries.at(-1).isIntersecting; }).observe(element);
}

export function axis(title, own = {}) {
  const grid = colour("line");
  return { title: { text: title, font: { size: 12 } }, gridcolor: grid, zerolinecolor: grid, automargin: true, ...own };
}

function show(plot) {
  const { traces, layout } = plot.draw();
  const shared = {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: colour("ink"), size: 11 },
    margin: { l: 55, r: 10, t: 8, b: 38 }, uirevision: "kept", hovermode: "closest",
    legend: { orientation: "h", x: 0, y: 1, yanchor: "bottom", traceorder: "normal", font: { size: 11 } },
  };
  const shown = Plotly.react(plot.element, traces, { ...shared, ...layout }, CONFIG);
  document.getElementById("js-plotly-tester")?.setAttribute("aria-hidden", "true"); // plotly measures text in it
  return shown;
}

let next = 0;
export async function drawInTurn(isNew) {
  const waiting = plots.filter((plot) => plot.visible && (isNew() || !plot.drawn));
  let took = 0;
  if (waiting.length && !document.hidden) {
    const plot = waiting[next++ % waiting.length];
    const begin = performance.now();
    await show(plot);
    plot.drawn = true;
    took = performance.now() - begin;
  }
  setTimeout(() => drawInTurn(isNew), Math.max(MIN_PAUSE_MS, SHARE * took));
}
