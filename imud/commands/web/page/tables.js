// The tables: which number stands where, with its standard deviation and unit; health in words. What is beyond its limit
// the daemon says (EST.out_of_limits); such a value is marked by colour and a word.

// name, value, sigma, decimals, unit, mark of the value if it has another, name of its limit if it is not the value's; of
// EST unless the value names another message
const ANGLES = [["roll", "roll_deg", "sroll_deg", 2, "deg"], ["pitch", "pitch_deg", "spitch_deg", 2, "deg"]];
const MOTION = [["heading", "heading_deg", "syaw_deg", 2, "deg"], ["rate of turn", "ATT.rot_dps", null, 1, "deg/s"]];
const PLACE = [
  ["latitude", "lat_deg", "sn_m", 6, "m", "°"], ["longitude", "lon_deg", "se_m", 6, "m", "°"], ["height", "height_m", "sd_m", 2, "m"],
  ["v north", "vn_mps", "svn_mps", 2, "m/s"], ["v east", "ve_mps", "sve_mps", 2, "m/s"], ["v down", "vd_mps", "svd_mps", 2, "m/s"],
];
const HEALTH = [
  ["last fix", "gnss_age_s", null, 1, "s ago"], ["satellites in use", "SKY.uSat", null, 0, "", "", "satellites"], ["HDOP", "SKY.hdop", null, 1, "", "", "hdop"],
  ["sensor temperature", "ATT.temp", null, 1, "°C", "", "temperature_c"], ["clock residual", "clock_residual_us", null, 0, "µs"], ["clock drift", "clock_drift_ppm", "sclock_drift_ppm", 1, "ppm"],
];
const TABLES = { angles: ANGLES, motion: MOTION, place: PLACE, health: HEALTH };

function value(news, key) {
  const [kind, name] = key.includes(".") ? key.split(".") : ["EST", key];
  return news[kind]?.[name];
}

function cell(text, kind = "") {
  const td = document.createElement("td");
  td.textContent = text;
  td.className = kind;
  return td;
}

function heading(text) {
  const th = document.createElement("th");
  th.scope = "row";
  th.textContent = text;
  return th;
}

function words(name, text, kind) {
  const row = document.createElement("tr");
  const shown = cell(text ?? "–", `words ${kind}`);
  shown.colSpan = 3;
  row.append(heading(name), shown);
  return row;
}

// A row for each port: its device and its faults, unless the rows of sensor and receiver show them, or why there is none.
function ports(news) {
  const shown = [news.EST?.imu_health, news.EST?.gnss_health].filter(Boolean);
  return parts(news.STATUS ?? {}, PORT).map(([, { path, streaming, model, driver, serial, baud, health: its, description }]) => {
    const device = [model || driver, serial].filter(Boolean).join(" ") + (baud ? `, ${baud} baud` : "");
    const isGood = its === "ok" || shown.some((text) => its?.startsWith(text)); // EST has the beginning
    const text = streaming ? [device, !isGood && its].filter(Boolean).join("; ") : description;
    return words(path.split("/").at(-1), text, streaming && isGood ? "" : "bad");
  });
}

function health(news, fresh) {
  return [["inertial sensor", "imu_health"], ["receiver", "gnss_health"]].map(([name, key]) => {
    const text = fresh ? news.EST?.[key] : null; // an old estimate has them as they were
    return words(name, text, text === "ok" ? "good" : text == null ? "unit" : "bad");
  });
}

const PORT = /^ports\.(\d+)\.(.+)$/;
const SOURCE = /^aiding\.sources\.(\w+)\.(.+)$/;
const REFUSED = "aiding.refused.";
const STALE_S = 3;

// The flat status's parts whose keys match: by the first group an object with the second one's values.
function parts(status, pattern) {
  const found = {};
  for (const [key, value] of Object.entries(status)) {
    const [, name, what] = pattern.exec(key) ?? [];
    if (name) (found[name] ??= {})[what] = value;
  }
  return Object.entries(found);
}

// What the filter has found out of a source.
function foundOf(its) {
  return [its.scale && `scale ${its.scale.toFixed(4)} ± ${its.sscale.toPrecision(1)}`,
    its.offset_m != null && `offset ${its.offset_m.toFixed(1)} ± ${its.soffset_m.toPrecision(2)} m`,
    its.boresight_deg != null && `boresight ${its.boresight_deg.toFixed(1)} ± ${its.sboresight_deg.toPrecision(1)}°`,
    ...["roll", "pitch", "yaw"].map((angle) => [angle, its[`mount_${angle}_deg`], its[`smount_${angle}_deg`]])
      .map(([angle, deg, sigma]) => deg != null && `${angle} ${deg.toFixed(1)} ± ${sigma.toFixed(1)}°`),
    its.deviation_deg != null && `deviates by ${its.deviation_deg.toFixed(1)}°`,
    its.late_s != null && `${its.late_s < 0 ? "early" : "late"} by ${Math.abs(its.late_s).toFixed(2)} s`].filter(Boolean).join(", ");
}

// Measurements beside fixes, a row for each source: whether they come and are used, what the filter has found out of
// it, and its share of what lowers the sigmas.
function sources(status) {
  return parts(status, SOURCE).map(([name, its]) => {
    const shares = Object.entries(its).filter(([what, share]) => what.startsWith("share.") && share >= 0.01)
      .map(([what, share]) => `${what.slice(6)} ${Math.round(100 * share)} %`).join(", ");
    const counts = its.used == null ? "" : `${its.used} used, ${its.rejected} rejected`;
    const ratio = its.ratio == null ? "" : `ratio ${rounded(its.ratio)}`;
    const rate = its.age_s > STALE_S ? `silent for ${Math.round(its.age_s)} s` : its.rate_hz == null ? "" : `${its.rate_hz.toFixed(1)} Hz`;
    const row = document.createElement("tr");
    row.append(heading(name), cell(its.finding ? `not used: ${its.finding}` : rate), cell(counts), cell(ratio, "number"),
      cell(foundOf(its)), cell(shares && `share: ${shares}`));
    row.className = its.finding || its.age_s > STALE_S ? "bad" : "";
    return row;
  });
}

// Lines of `aiding.listen` that could not be used, by reason.
function refused(status) {
  const last = status["aiding.last_refused"];
  const counts = Object.entries(status).filter(([key]) => key.startsWith(REFUSED)).map(([key, count]) => `${count} for ${key.slice(REFUSED.length)}`);
  const row = document.createElement("tr");
  row.append(heading("refused"), cell([counts.join(", "), last && `the last line: ${last}`].filter(Boolean).join("; ")));
  row.lastChild.colSpan = 5;
  return counts.length ? [row] : [];
}

// What the filter has found of receiver and vehicle, where it differs from zero.
function estimated(news) {
  return Object.entries(news.STATUS?.found ?? {}).map(([name, text]) => words(name, text, ""));
}

function rounded(sigma) {
  return sigma < 99.5 ? sigma.toPrecision(2) : sigma.toFixed(0);
}

// fresh: whether estimates come.
export function fillTables(news, fresh) {
  const beyond = (news.EST?.out_of_limits ?? "").split(",");
  for (const [id, rows] of Object.entries(TABLES)) {
    const lines = rows.map(([name, key, sigma, decimals, unit, mark = "", limit = key]) => {
      const isBad = beyond.includes(limit);
      const number = value(news, key), spread = sigma && value(news, sigma);
      const row = document.createElement("tr");
      const title = key === "heading_deg" && !news.EST?.state?.includes("heading") ? "yaw" : name;
      row.append(heading(isBad ? `${title}: beyond its limit` : title), cell(number == null ? "–" : number.toFixed(decimals) + mark, "number"),
        cell(number == null || spread == null ? "" : `± ${rounded(spread)}`, "number"), cell(unit, "unit"));
      row.className = isBad ? "bad" : "";
      return row;
    });
    const said = id === "health" ? [...ports(news), ...health(news, fresh), ...estimated(news)] : [];
    document.getElementById(id).replaceChildren(...said, ...lines);
  }
  const aiding = [...sources(news.STATUS ?? {}), ...refused(news.STATUS ?? {})];
  document.getElementById("aiding").replaceChildren(...aiding);
  document.getElementById("aiding").parentElement.hidden = !aiding.length;
}
