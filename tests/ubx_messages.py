"""Messages of a u-blox receiver, encoded by pyubx2."""

from pyubx2 import GET, UBXMessage

ITOW = 200_000_000
TIME = {"year": 2026, "month": 11, "day": 23, "hour": 7, "min": 33, "second": 2}
KNOWN = {"validDate": 1, "validTime": 1, "fullyResolved": 1}
PLACE = {"lat": 48.1173, "lon": -11.5166667, "height": 592300, "hMSL": 545400, "hAcc": 1500, "vAcc": 2500}
MOTION = {"velN": 3000, "velE": -4000, "velD": 500, "gSpeed": 5000, "headMot": 306.8699, "sAcc": 120}
VARIANCES = {"posCovNN": 1.0, "posCovEE": 4.0, "posCovDD": 9.0, "velCovNN": 0.01, "velCovEE": 0.04, "velCovDD": 0.09}


def message(group, name, **fields):
    return UBXMessage(group, name, GET, **fields).serialize()


def pvt(itow=ITOW, **changes):
    flags = {"fixType": 3, "gnssFixOk": 1, "numSV": 14, "pDOP": 1.5}
    return message("NAV", "NAV-PVT", **{"iTOW": itow, **TIME, **KNOWN, **flags, **PLACE, **MOTION, **changes})


def cov(itow=ITOW, **changes):
    return message("NAV", "NAV-COV", **{"iTOW": itow, "posCovValid": 1, "velCovValid": 1, **VARIANCES, **changes})


def eoe(itow=ITOW):
    return message("NAV", "NAV-EOE", iTOW=itow)
