// The page: news in, drawings out. News is the newest gpsd message of each class, and whether the daemon is there.

import { drawCompass, drawHorizon } from "./horizon.js";
import { connect } from "./link.js";
import { drawInTurn } from "./plots.js";
import { drawPose, turnView } from "./pose.js";
import { placeOf, receives } from "./receiver.js";
import { onRecord, permit, tellRecording } from "./record.js";
import { makeStrips, remember } from "./strips.js";
import { fillTables } from "./tables.js";
import { follow, forgetTrack, makeTrack } from "./track.js";

const STALE_MS = 1500;
const NORTH_UNKNOWN_DEG = 103.9; // the sigma of an angle of which nothing is known
const GOOD = ["attitude", "heading", "position", "height", "at-rest"];

const byId = (id) => document.getElementById(id);
let news = { connected: false, why: "connecting" };
let heard = -Infinity; // when the newest estimate came
let fresh = false; // estimates come
let onlyFixes = false; // no estimates, but the receiver's fixes

function say(text, kind) {
  const link = byId("link");
  if (link.textContent !== text) link.textContent = text; // read aloud only when it changes
  link.className = `pill ${kind}`;
  document.body.classList.toggle("stale", kind !== "good");
}

function tellLink() {
  const age = performance.now() - heard;
  fresh = news.connected && age < STALE_MS;
  onlyFixes = news.connected && !fresh && receives(news);
  if (news.lost) say("imud web does not answer: trying again", "bad");
  else if (!news.connected) say(`no daemon at ${news.daemon ?? "?"}: ${news.why}; trying again`, "bad");
  else if (onlyFixes) say("no inertial sensor: the receiver's fixes", "good");
  else if (heard === -Infinity) say("daemon is there, no sensor data yet", "doubt");
  else if (!fresh) say(`no sensor data for ${Math.round(age / 1000)} s`, "doubt");
  else say("live", "good");
}

function tellState(est) {
  byId("words").replaceChildren(...(est.state ?? "").split(",").filter(Boolean).map((word) => {
    const pill = document.createElement("span");
    pill.className = `pill ${GOOD.includes(word) ? "good" : "doubt"}`;
    pill.textContent = word;
    return pill;
  }));
  byId("source").textContent = est.estimator ?? "";
}

// The news with the receiver's position where the estimate has none.
function shownNews() {
  if (onlyFixes) return { ...news, ATT: null, EST: placeOf(news.TPV) };
  return news.EST && receives(news) ? { ...news, EST: { ...news.EST, ...placeOf(news.TPV) } } : news;
}

function draw() {
  const shown = shownNews();
  const est = shown.EST ?? {};
  const known = (est.state ?? "aligning").includes("aligning") ? {} : est;
  drawHorizon(byId("horizon"), known.roll_deg, known.pitch_deg);
  drawCompass(byId("compass"), known.heading_deg, known.syaw_deg, est.state?.includes("heading"));
  drawPose(byId("pose"), known.q0 == null ? null : [known.q0, known.q1, known.q2, known.q3], est.state?.includes("heading"));
  fillTables(shown, fresh);
  tellState(est);
}

let asked = false;
function drawSoon() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => { asked = false; draw(); });
}

function take(message) {
  if ("control" in message) return permit(message.control);
  const before = news.EST?.t_mono_ns;
  news = message;
  const { ATT: att, EST: est } = news;
  if (att?.rot != null) att.rot_dps = att.rot / 60; // gpsd's is in deg/min
  if (est?.yaw_deg != null && !(est.syaw_deg >= NORTH_UNKNOWN_DEG)) est.heading_deg = (est.yaw_deg + 360) % 360;
  if (est && est.t_mono_ns !== before) {
    heard = performance.now();
    remember(news);
  }
  tellLink();
  if (onlyFixes) follow({ ...shownNews().EST, state: "", t_mono_ns: Date.parse(news.TPV.time) * 1e6 });
  else if (est && est.t_mono_ns !== before) follow(shownNews().EST);
  tellRecording(news.RECORD);
  drawSoon();
}

makeTrack(byId("track"));
makeStrips(byId("charts"));
turnView(byId("pose"), drawSoon);
byId("anew").addEventListener("click", forgetTrack);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawSoon);
addEventListener("resize", drawSoon);
setInterval(tellLink, 500);
onRecord(connect(take, () => { news = { ...news, connected: false, lost: true }; tellLink(); tellRecording(null); }));
draw();
addEventListener("load", () => drawInTurn(() => fresh || onlyFixes));
