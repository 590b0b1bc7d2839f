"""The status of a daemon on one screen: which number stands where, and what is marked as beyond its limit."""

import contextlib
import math
import textwrap
from collections.abc import Collection, Iterator, Mapping
from itertools import zip_longest
from typing import Any

from ...sensors.limits import is_beyond
from .notable_states import notable_states

_WIDTH = 100  # of the text to the right of the names
_SILENT_S = 2.0  # without a sample, from which on the estimate is called old
_UNKNOWN_YAW_DEG = 103.9  # sigma of an angle of which nothing is known: 180 / √3
_LEAST = 0.01  # share of a sigma's reduction that is shown
Table = Mapping[str, Any]


def lines(status: Table) -> Iterator[tuple[str, str]]:
    """Lines for people, each with its name."""
    load = "OVERLOADED" if status["load"]["overloaded"] else "keeps up"
    yield "imud", f"{status['version']}, pid {status['pid']}, up {_duration(status['uptime_s'])}, {load}"
    yield from _filter(status["filter"])
    yield from _states(status.get("states", {}))
    if by_kind := status.get("innovations"):
        yield from zip_longest(["innovations"], innovations(by_kind), fillvalue="")
    for port in status["ports"]:
        yield from _port(port)
    if aiding := status.get("aiding"):
        yield from zip_longest(["aiding"], measurements(aiding), fillvalue="")
    if corrections := status.get("corrections"):
        names = ("frames", "forwarded", "noise bytes")
        counts = ", ".join(f"{corrections[name]} {name}" for name in names if name in corrections)
        yield "rtcm", f"{corrections['source']}: {'; '.join(filter(None, (corrections['state'], counts)))}"
    for name, output in status["outputs"].items():
        if addresses := output.pop("addresses", ""):
            yield name, addresses
        yield "" if addresses else name, ", ".join(_number_of(count, what) for what, count in output.items())
    share = 100.0 * status["cpu_s"] / max(status["uptime_s"], 1e-3)
    megabytes = (status[key] / 2**20 for key in ("memory_bytes", "memory_peak_bytes"))
    memory = "{:.0f} MB of memory ({:.0f} at most)".format(*megabytes)
    yield "process", f"{share:.1f} % of a processor, {memory}, {status['open_files']} descriptors"
    yield "kernels", status["kernels"]


def innovations(by_kind: Table) -> list[str]:
    """The mean normalised square of each kind, and the counts of all."""
    ratios = ", ".join(
        _marked(f"{kind} {entry['ratio']:.2f}", is_beyond("innovation_ratio", entry["ratio"]))
        for kind, entry in by_kind.items()
        if "ratio" in entry
    )
    used, rejected = (sum(entry[what] for entry in by_kind.values()) for what in ("used", "rejected"))
    counts = f"{used} used, {rejected} rejected"
    return [*textwrap.wrap(ratios, _WIDTH), f"ratio 1 is right, less is cautious; {counts}"] if ratios else [counts]


def measurements(aiding: Table) -> Iterator[str]:
    """What came of each source of measurements, and what could not be used."""
    if "address" in aiding:
        yield aiding["address"]
    for name, source in aiding.get("sources", {}).items():
        rate = f"{source['rate_hz']:.4g}" if "rate_hz" in source else "?"
        yield f"{name}: {source['received']} received, {rate} Hz, the last {source['age_s']:.1f} s ago{_use(source)}"
        if "refused" in source:
            text = f"{source['refused']} of them refused, the last one: {source['last_refused']}"
            yield from textwrap.wrap(text, _WIDTH, initial_indent="  ", subsequent_indent="  ")
        yield from _estimates(source)
        yield from _share(source)
    if refused := aiding.get("refused"):
        yield "refused: " + ", ".join(f"{count} for {rule}" for rule, count in refused.items())
    if "last_refused" in aiding:
        yield from textwrap.wrap(f"the last line that was: {aiding['last_refused']}", _WIDTH, initial_indent="  ")


def _use(source: Table) -> str:
    """What became of a source's measurements."""
    if "used" not in source:
        return ""
    ratio = source.get("ratio")
    text = "" if ratio is None else _marked(f", ratio {_two_digits(ratio)}", is_beyond("innovation_ratio", ratio))
    return f"; {source['used']} used, {source['rejected']} rejected{text}"


def _two_digits(number: float) -> str:
    return f"{number:.0f}" if number >= 99.5 else f"{number:.2g}"


def _estimates(source: Table) -> Iterator[str]:
    """What the filter has found out of a source."""
    forms = (
        ("scale", "sscale", "scale {:.4f} ± {:.1g}"),
        ("offset_m", "soffset_m", "offset {:+.1f} ± {:.1g} m"),
        ("boresight_deg", "sboresight_deg", "boresight {:+.1f} ± {:.1g}°"),
        *((f"mount_{angle}_deg", f"smount_{angle}_deg", f"{angle} {{:+.1f}} ± {{:.1f}}°") for angle in _ANGLES),
    )
    texts = [form.format(source[key], source[sigma]) for key, sigma, form in forms if key in source]
    if "late_s" in source:
        texts.append(f"{'early' if source['late_s'] < 0.0 else 'late'} by {abs(source['late_s']):.2f} s")
    if "deviation_deg" in source:
        texts.append(f"deviates by {source['deviation_deg']:.1f}°")
    if texts:
        yield "  found: " + ", ".join(texts)
    if "finding" in source:
        yield f"  NOT USED: {source['finding']}"


def _share(source: Table) -> Iterator[str]:
    """Its share of what lowers the sigmas, where it is at least a hundredth."""
    shares = [f"{name} {100.0 * share:.0f} %" for name, share in source.get("share", {}).items() if share >= _LEAST]
    if "share" in source:
        yield "  share: " + (", ".join(shares) or f"less than {100.0 * _LEAST:.0f} % of any sigma's reduction")


def _duration(seconds: float) -> str:
    minutes, s = divmod(round(seconds), 60)
    hours, m = divmod(minutes, 60)
    days, h = divmod(hours, 24)
    parts = [(days, "d"), (h, "h"), (m, "min"), (s, "s")]
    first = next((i for i, (count, _) in enumerate(parts) if count), 3)
    return " ".join(f"{count} {unit}" for count, unit in parts[first : first + 2])


def _filter(f: Table) -> Iterator[tuple[str, str]]:
    state = f.get("state", "no samples yet").replace(",", ", ")
    silence = f"no sample for {_duration(f['age_s'])}; before: " if f.get("age_s", 0.0) >= _SILENT_S else ""
    yield "filter", f"{f['estimator']}: {silence}{state}"
    if "finding" in f:
        yield "", f["finding"]
    yield from _attitude(f)
    for name, columns in _ROWS:
        known = [(what, key, sigma, form) for what, key, sigma, form in columns if key in f]
        texts = [f"{what} {form.format(f[key], f.get(sigma, math.inf))}" for what, key, sigma, form in known]
        if texts:
            yield name, ", ".join(texts)


def _attitude(f: Table) -> Iterator[tuple[str, str]]:
    if "roll_deg" not in f:
        return
    roll, pitch, yaw = (f"{a} {f[f'{a}_deg']:+.2f} ±{f.get(f's{a}_deg', math.inf):.2f}°" for a in _ANGLES)
    if f.get("syaw_deg", math.inf) >= _UNKNOWN_YAW_DEG:
        yaw = "yaw unknown"
    elif not f["flags"]["heading"]:
        yaw += " from the start, not from north"
    yield "attitude", f"{roll}, {pitch}, {yaw}"


def _states(found: Table) -> Iterator[tuple[str, str]]:
    text = ", ".join(f"{label} {values}" for label, values in notable_states(found).items())
    yield from zip_longest(["found"] if text else [], textwrap.wrap(text, _WIDTH), fillvalue="")


_ANGLES = ("roll", "pitch", "yaw")
_Row = tuple[tuple[str, str, str, str], ...]  # of each column its name, keys of value and sigma, format
_POSITION: _Row = (
    ("lat", "lat_deg", "sn_m", "{:.7f}° ±{:.2f} m"),
    ("lon", "lon_deg", "se_m", "{:.7f}° ±{:.2f} m"),
    ("height", "height_m", "sd_m", "{:.2f} ±{:.2f} m"),
)
_ROWS: tuple[tuple[str, _Row], ...] = (
    ("position", _POSITION),
    ("velocity", tuple((a, f"v{a}_mps", f"sv{a}_mps", "{:+.3f} ±{:.3f} m/s") for a in "ned")),
    ("gyro bias", tuple((a, f"bg{a}_dps", f"sbg{a}_dps", "{:+.4f} ±{:.4f}°/s") for a in "xyz")),
    ("accel bias", tuple((a, f"ba{a}_mps2", f"sba{a}_mps2", "{:+.4f} ±{:.4f} m/s²") for a in "xyz")),
)


def _port(port: Table) -> Iterator[tuple[str, str]]:
    if not port["streaming"]:
        description = port["description"]
        yield "port", description if port["path"] in description else f"{port['path']}: {description}"
        return
    facts = [port["model"] or port["driver"]]
    facts += [f"{word} {port[key]}" for word, key in (("serial", "serial"), ("firmware", "firmware")) if port[key]]
    facts += [f"{port['baud']} baud"] if "baud" in port else []
    yield "port", f"{port['path']}: {', '.join(facts)}; {port['health']}"
    sentences = port.get("sentences", {})
    has_positions = not sentences or any("fix" in what for what in sentences)
    counts = f"{_rate(port)}, {_counted(port, _COUNTED)}, " if has_positions else ""
    yield "", f"{counts}connected {_times(port['connects'])}"
    if clock := port.get("clock"):
        fit = _clock(clock, port.get("out_of_limits", "").split(","))
        yield from (("", line) for line in textwrap.wrap(fit, _WIDTH))
    if "quality" in port:
        if has_positions:
            yield "", f"fix: {_fix(port)}"
        if sentences:
            yield "", "sentences: " + ", ".join(f"{count} {what}" for what, count in sentences.items())


_FIX = (
    ("lat_deg", "lat {:.6f}°", "position"),
    ("lon_deg", "lon {:.6f}°", "position"),
    ("quality", "quality {}", "gnss_quality"),
    ("satellites", "{} satellites", "satellites"),
    ("hdop", "HDOP {:g}", "hdop"),
    ("fix_age_s", "{:.1f} s ago", "gnss_age_s"),
)
_COUNTED = ("frames", "lost", "junk", "bad", "suspect", "errors", "overruns", "torn", "unannounced", "used")


def _rate(port: Table) -> str:
    rate = f"{port['rate_hz']:.4g}" if "rate_hz" in port else "?"
    return f"{rate} of {port['rate_asked_hz']:.4g} Hz" if "rate_asked_hz" in port else f"{rate} fixes/s"


def _counted(port: Table, names: tuple[str, ...]) -> str:
    refused = "".join(f", {count} refused for {rule}" for rule, count in port.get("refused", {}).items())
    return ", ".join(_number_of(port[name], name) for name in names if name in port) + refused


def _number_of(count: int, what: str) -> str:
    """What is counted, in the singular where it is one."""
    return f"{count} {what.removesuffix('s') if count == 1 else what}"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _clock(clock: Table, beyond: Collection[str]) -> str:
    fit = "not fitted yet"
    if "drift_ppm" in clock:
        drift = _marked(f"drift {clock['drift_ppm']:+.1f} ppm", "clock_drift_ppm" in beyond)
        residual = _marked(f"residual {clock['residual_us']:.0f} µs", "clock_residual_us" in beyond)
        fit = f"{drift}, {residual}"
    latest = _marked(f"{1e-3 * clock['latest_us']:.1f} at most", is_beyond("samples_late_us", clock["latest_us"]))
    late = f"samples {1e-3 * clock['late_us']:.2f} ms late in the mean, {latest}"
    return f"clock: {fit}, {clock['corrections']} corrections; {late}"


def _marked(text: str, is_bad: bool) -> str:
    """The text, with a mark if its number is beyond the limit."""
    return f"{text} (beyond its limit)" if is_bad else text


def _fix(port: Table) -> str:
    facts = list[str]()
    for key, form, limit in _FIX:
        with contextlib.suppress(KeyError):
            facts.append(_marked(form.format(port[key]), limit in port.get("out_of_limits", "").split(",")))
    return ", ".join(facts)
