"""NMEA sentences made to order, with their checksum from a plain loop, and a decoder that takes them all."""

from imud.drivers.nmea.burst_silence import SILENCE_NS
from imud.drivers.nmea.decoder import NmeaDecoder


def checksum(body):
    total = 0
    for byte in body:
        total ^= byte
    return total


def line(body, end=b"\r\n"):
    body = body.encode() if isinstance(body, str) else body
    return b"$%s*%02X%s" % (body, checksum(body), end)


def gga(time="120000.000", lat="4807.038,N", lon="01131.000,E", rest="1,08,0.9,545.4,M,46.9,M,,"):
    return line(f"GPGGA,{time},{lat},{lon},{rest}")


def rmc(time="120000.000", status="A", motion="022.4,084.4", day="230394", tail=",,,A"):
    return line(f"GPRMC,{time},{status},4807.038,N,01131.000,E,{motion},{day}{tail}")


def vtg(course="054.7", kmh="010.2", mode=",A"):
    return line(f"GPVTG,{course},T,034.4,M,005.5,N,{kmh},K{mode}")


def decode(data):
    """Fixes and decoder after `data` and a pause."""
    decoder = NmeaDecoder()
    return decoder.feed(data, 1) + decoder.flush(1 + SILENCE_NS), decoder
