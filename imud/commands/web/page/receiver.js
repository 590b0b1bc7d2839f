// The receiver's own position (gpsd's TPV), shown where no filter gives one: without an inertial sensor, or beside an
// estimator that takes no fixes.

const STALE_MS = 3000; // a receiver of one fix per second may be late
const BOUND_95 = 1.959964; // gpsd's errors hold 95 %

let time = null, heard = -Infinity;

// Whether the receiver's own fixes come; a TPV of the filter has the device of its estimates.
export function receives({ TPV: tpv, EST: est }) {
  if (tpv?.lat == null || tpv.device === est?.device) return false;
  if (tpv.time !== time) [time, heard] = [tpv.time, performance.now()];
  return performance.now() - heard < STALE_MS;
}

// The position as the fields of EST.
export function placeOf(tpv) {
  const sigma = (bound) => (bound == null ? null : bound / BOUND_95);
  return {
    lat_deg: tpv.lat, lon_deg: tpv.lon, height_m: tpv.altHAE, sn_m: sigma(tpv.epy), se_m: sigma(tpv.epx), sd_m: sigma(tpv.epv),
    vn_mps: tpv.velN, ve_mps: tpv.velE, vd_mps: tpv.velD, svn_mps: sigma(tpv.eps), sve_mps: sigma(tpv.eps), svd_mps: sigma(tpv.epc),
  };
}
