"""Tracks for maps and for other programs: GPX 1.1, KML 2.2 with Google's gx:Track, GeoJSON (RFC 7946).

Two tracks: that of the estimates, and that of the receiver's fixes as they came. Each point has its time, and its
sigmas where they are known. A track is interrupted where the position is not valid, and where none comes for GAP_S.
Heights are above the WGS-84 ellipsoid, and are left out where they are not known.
"""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TextIO
from xml.sax.saxutils import escape

from ..estimators.records import HEIGHT_VALID, POSITION_VALID
from ..math.arrays import Records

GAP_S = 10.0
NAMESPACE = "https://imud.invalid/gpx/1"  # of the sigmas in GPX
SIGMAS = ("sigma_n_m", "sigma_e_m", "sigma_d_m")


@dataclass(frozen=True)
class Point:
    """A position. NaN: unknown."""

    unix_ns: int
    lat_deg: float
    lon_deg: float
    height_m: float
    sigma_m: tuple[float, float, float]  # north, east, down

    @property
    def time(self) -> str:
        """ISO 8601, UTC, to the millisecond."""
        moment = datetime.fromtimestamp(self.unix_ns // 1_000_000_000, UTC)
        return f"{moment:%Y-%m-%dT%H:%M:%S}.{self.unix_ns // 1_000_000 % 1000:03d}Z"

    @property
    def known_sigmas(self) -> dict[str, float]:
        """By name, m."""
        return {name: round(s, 4) for name, s in zip(SIGMAS, self.sigma_m, strict=True) if math.isfinite(s)}

    @property
    def coordinates(self) -> list[float]:
        """Longitude, latitude and, if it is known, height."""
        height = [round(self.height_m, 4)] if math.isfinite(self.height_m) else []
        return [round(self.lon_deg, 9), round(self.lat_deg, 9), *height]


@dataclass
class Track:
    """Points in order of time, in segments."""

    name: str
    about: str
    segments: list[list[Point]] = field(default_factory=list)
    _interrupted: bool = True

    def add(self, point: Point) -> None:
        """The next point. A point without a position interrupts the track."""
        if not math.isfinite(point.lat_deg + point.lon_deg):
            self._interrupted = True
            return
        if self._interrupted or point.unix_ns - self.segments[-1][-1].unix_ns > GAP_S * 1e9:
            self.segments.append([])
        self.segments[-1].append(point)
        self._interrupted = False


def point_of_solution(row: Records, offset_ns: int) -> Point:
    """Of a row of SOLUTION; offset_ns: Unix time less its clock."""
    where = row["status"] & POSITION_VALID
    height = float(row["height"]) if row["status"] & HEIGHT_VALID else math.nan
    lat, lon = (math.degrees(row[name]) if where else math.nan for name in ("lat", "lon"))
    north, east, down = row["sigma_p"].tolist()
    return Point(int(row["t_ns"]) + offset_ns, lat, lon, height, (north, east, down if height == height else math.nan))  # noqa: PLR0124 - NaN


def point_of_fix(row: Records, offset_ns: int) -> Point:
    """Of a row of FIX."""
    lat, lon = math.degrees(row["lat"]), math.degrees(row["lon"])
    north, east, down = row["sigma"].tolist()
    return Point(int(row["t_ns"]) + offset_ns, lat, lon, float(row["height"]), (north, east, down))


def write_gpx(file: TextIO, tracks: list[Track]) -> None:
    """GPX 1.1: the sigmas are extensions of each point."""
    file.write(
        '<?xml version="1.0" encoding="UTF-8"?>\n<gpx version="1.1" creator="imud" '
        f'xmlns="http://www.topografix.com/GPX/1/1" xmlns:imud="{NAMESPACE}">\n'
    )
    for track in tracks:
        file.write(f"<trk><name>{escape(track.name)}</name><desc>{escape(track.about)}</desc>\n")
        for segment in track.segments:
            file.write("<trkseg>\n")
            for point in segment:
                lon, lat, *height = point.coordinates
                ele = f"<ele>{height[0]}</ele>" if height else ""
                sigmas = "".join(f"<imud:{name}>{s}</imud:{name}>" for name, s in point.known_sigmas.items())
                more = f"<extensions>{sigmas}</extensions>" if sigmas else ""
                file.write(f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}">{ele}<time>{point.time}</time>{more}</trkpt>\n')
            file.write("</trkseg>\n")
        file.write("</trk>\n")
    file.write("</gpx>\n")


def write_kml(file: TextIO, tracks: list[Track]) -> None:
    """KML 2.2: a gx:MultiTrack each, the sigmas in arrays of extended data."""
    fields = "".join(
        f'<gx:SimpleArrayField name="{name}" type="float"><displayName>{name}</displayName></gx:SimpleArrayField>'
        for name in SIGMAS
    )
    file.write(
        '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2" '
        'xmlns:gx="http://www.google.com/kml/ext/2.2">\n<Document><name>imud</name>\n'
        f'<Schema id="sigmas">{fields}</Schema>\n'
    )
    for track in tracks:
        file.write(f"<Placemark><name>{escape(track.name)}</name><description>{escape(track.about)}</description>\n")
        file.write("<gx:MultiTrack><gx:interpolate>0</gx:interpolate>\n")
        for segment in track.segments:
            has_height = all(len(point.coordinates) == 3 for point in segment)
            mode = "absolute" if has_height else "clampToGround"
            file.write(f"<gx:Track><altitudeMode>{mode}</altitudeMode>\n")
            file.writelines(f"<when>{point.time}</when>\n" for point in segment)
            file.writelines(
                f"<gx:coord>{' '.join(map(str, (*point.coordinates, 0)[:3]))}</gx:coord>\n" for point in segment
            )
            file.write('<ExtendedData><SchemaData schemaUrl="#sigmas">')
            for name in SIGMAS:
                values = "".join(f"<gx:value>{point.known_sigmas.get(name, '')}</gx:value>" for point in segment)
                file.write(f'<gx:SimpleArrayData name="{name}">{values}</gx:SimpleArrayData>')
            file.write("</SchemaData></ExtendedData></gx:Track>\n")
        file.write("</gx:MultiTrack></Placemark>\n")
    file.write("</Document></kml>\n")


def write_geojson(file: TextIO, tracks: list[Track]) -> None:
    """GeoJSON: a MultiLineString for each track, and a Point with time and sigmas for each of its points."""
    file.write('{"type":"FeatureCollection","features":[\n')
    file.write(",\n".join(json.dumps(feature, separators=(",", ":")) for feature in _features(tracks)))
    file.write("\n]}\n")


def _features(tracks: list[Track]) -> Iterator[dict[str, object]]:
    for track in tracks:
        lines = [[point.coordinates for point in segment] for segment in track.segments if len(segment) > 1]
        yield _feature("MultiLineString", lines, {"track": track.name, "description": track.about})
        for point in (point for segment in track.segments for point in segment):
            yield _feature("Point", point.coordinates, {"track": track.name, "time": point.time, **point.known_sigmas})


def _feature(kind: str, coordinates: object, properties: dict[str, object]) -> dict[str, object]:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": properties}


WRITERS = {"gpx": write_gpx, "kml": write_kml, "geojson": write_geojson}
