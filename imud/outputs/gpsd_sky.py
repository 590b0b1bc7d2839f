"""SKY: the receiver's last report of the satellites, in gpsd's numbering."""

from imud.drivers.fix import Satellite

from .gpsd_objects import Numbers, head, time_of
from .view import NAN, View

_SKY = Numbers(hdop="%.4g", pdop="%.4g", vdop="%.4g", nSat="%.4g", uSat="%.4g")
_SATELLITE = Numbers(gnssid="%d", svid="%d", el="%.4g", az="%.4g", ss="%.4g")
_FIX_AGE_MAX_S = 10.0
_SATELLITES_MAX = 100  # 140 would blank libgps' list, and 10 kB are too long for a line
_SBAS, _SBAS_OFFSET = 1, 87  # NMEA calls PRN 120 satellite 33
_OFFSETS = {2: 300, 3: 400, 5: 192, 6: 64}  # from svid to PRN, by gnssid


def _prn_and_svid(satellite: Satellite) -> tuple[int, int]:
    """PRN and svid in gpsd's numbering; receivers number Galileo, BeiDou and QZSS from 1, or as PRN."""
    if satellite.system == _SBAS:
        return satellite.number + _SBAS_OFFSET, satellite.number + _SBAS_OFFSET
    offset = _OFFSETS.get(satellite.system, 0)
    svid = satellite.number - offset if satellite.number > offset else satellite.number
    return svid + offset, svid


def _satellite(satellite: Satellite) -> str:
    prn, svid = _prn_and_svid(satellite)
    known = (satellite.elevation_deg, satellite.azimuth_deg, satellite.signal_dbhz)
    numbers = _SATELLITE(satellite.system, svid, *(NAN if value is None else value for value in known))
    return f'{{"PRN":{prn}{numbers},"used":{"true" if satellite.used else "false"}}}'


def sky_object(view: View) -> str:
    """Dilutions and satellites as far as the receiver reports them, with a fix that is not older than 10 s, or none.

    Satellites are those of a list that is not older, either.
    """
    gnss = view.gnss
    if gnss is None or (gnss.quality != 0 and gnss.age_s > _FIX_AGE_MAX_S):
        return f"{head('SKY', view)}{time_of(view)}}}"
    sky, used = gnss.sky, NAN if gnss.satellites is None or gnss.satellites < 0 else gnss.satellites
    dops = (NAN if dop is None else dop for dop in (sky.pdop, sky.vdop))
    numbers = _SKY(gnss.hdop, *dops, len(sky.satellites) or used, used)
    shown = sorted(sky.satellites, key=lambda satellite: not satellite.used)[:_SATELLITES_MAX]
    satellites = f',"satellites":[{",".join(map(_satellite, shown))}]' if shown else ""
    return f"{head('SKY', view)}{time_of(view)}{numbers}{satellites}}}"
