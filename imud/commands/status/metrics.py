"""The status of a daemon as Prometheus metrics: which number is which metric, in base units, and the text format.

Source: prometheus.io/docs/instrumenting/exposition_formats (text format 0.0.4), prometheus.io/docs/practices/naming.
"""

import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from ...filter_state_names import STATES


class Metric(NamedTuple):
    """A family of samples. `pattern`: matches the keys of the flat status; its groups are the labels."""

    name: str
    kind: str
    about: str
    pattern: str
    scale: float = 1.0


_GAUGE, _COUNTER = "gauge", "counter"
_UNITS = {"s": "seconds", "m": "meters", "mps": "meters_per_second", "deg": "degrees", "": "ratio"}


def _of_filter_states() -> Iterator[Metric]:
    """Two for each kind of what a filter estimates beside its solution: value and sigma, labelled by their parts."""
    for kind in dict.fromkeys(state.kind for state in STATES):
        states = [state for state in STATES if state.kind == kind]
        parts, unit = "|".join(state.part for state in states), states[0].shown_unit
        pattern = "_".join(filter(None, (kind, f"(?P<part>{parts})" if parts else "", unit)))
        about = f"{states[0].about[0].upper()}{states[0].about[1:]}."
        yield Metric(f"imud_{kind}_{_UNITS[unit]}", _GAUGE, about, rf"states\.{pattern}")
        yield Metric(f"imud_{kind}_sigma_{_UNITS[unit]}", _GAUGE, "Its deviation.", rf"states\.s{pattern}")


_PORT = r"ports\.(?P<port>\d+)\."
_SINCE = ", since it streams"
METRICS = (
    Metric("imud_uptime_seconds", _GAUGE, "Since the daemon started.", "uptime_s"),
    Metric("process_cpu_seconds_total", _COUNTER, "Processor time.", "cpu_s"),
    Metric("process_resident_memory_bytes", _GAUGE, "Memory in use.", "memory_bytes"),
    Metric("process_open_fds", _GAUGE, "Open descriptors.", "open_files"),
    Metric("imud_overloaded", _GAUGE, "1: the machine cannot keep up with the sensor.", r"load\.overloaded"),
    Metric("imud_batches_shed_total", _COUNTER, "Batches after which messages waited for lack of time.", r"load\.shed"),
    Metric("imud_port_streaming", _GAUGE, "1: a device sends on this port.", _PORT + "streaming"),
    Metric("imud_port_connects_total", _COUNTER, "Times that a device began to send.", _PORT + "connects"),
    Metric("imud_port_faults", _GAUGE, "Faults of the device at present.", _PORT + "fault_count"),
    Metric("imud_port_rate_hertz", _GAUGE, "Samples or fixes per second over ten seconds.", _PORT + "rate_hz"),
    Metric("imud_port_rate_asked_hertz", _GAUGE, "Samples per second that were asked for.", _PORT + "rate_asked_hz"),
    Metric("imud_port_frames_total", _COUNTER, f"Good frames{_SINCE}.", _PORT + "frames"),
    Metric("imud_port_junk_bytes_total", _COUNTER, f"Bytes that are of no frame{_SINCE}.", _PORT + "junk"),
    Metric("imud_port_bad_frames_total", _COUNTER, f"Damaged frames{_SINCE}.", _PORT + "bad"),
    Metric("imud_port_lost_samples_total", _COUNTER, f"Samples that did not arrive{_SINCE}.", _PORT + "lost"),
    Metric("imud_port_suspect_samples_total", _COUNTER, f"Samples with impossible values{_SINCE}.", _PORT + "suspect"),
    Metric("imud_port_errors_total", _COUNTER, f"Samples with the device's error flag{_SINCE}.", _PORT + "errors"),
    Metric(
        "imud_port_line_faults_total", _COUNTER, f"Faults of the line below the frames{_SINCE}.",
        _PORT + "(?P<fault>overruns|torn|unannounced)",
    ),
    Metric("imud_clock_drift_ratio", _GAUGE, "Sensor clock against host clock.", _PORT + r"clock\.drift_ppm", 1e-6),
    Metric(
        "imud_clock_residual_seconds", _GAUGE, "Median distance of the earliest arrivals from the fitted line.",
        _PORT + r"clock\.residual_us", 1e-6,
    ),
    Metric(
        "imud_arrival_lateness_seconds", _GAUGE, "Arrival of samples after the earliest possible, mean.",
        _PORT + r"clock\.late_us", 1e-6,
    ),
    Metric(
        "imud_arrival_lateness_max_seconds", _GAUGE, "Arrival of samples after the earliest possible, maximum.",
        _PORT + r"clock\.latest_us", 1e-6,
    ),
    Metric(
        "imud_clock_corrections_total", _COUNTER, "Corrections of the sensor's counter.",
        _PORT + r"clock\.corrections",
    ),
    Metric("imud_fixes_used_total", _COUNTER, f"Fixes given to the filter{_SINCE}.", _PORT + "used"),
    Metric("imud_fixes_refused_total", _COUNTER, "Fixes refused, by reason.", _PORT + r"refused\.(?P<rule>.+)"),
    Metric(
        "imud_receiver_messages_total", _COUNTER, "Messages and epochs of a receiver by outcome.",
        _PORT + r"sentences\.(?P<outcome>(?!noise bytes).+)",
    ),
    Metric("imud_receiver_noise_bytes_total", _COUNTER, "Bytes in no message.", _PORT + r"sentences\.noise bytes"),
    Metric("imud_satellites", _GAUGE, "Satellites that the receiver uses.", _PORT + "satellites"),
    Metric("imud_fix_quality", _GAUGE, "Quality of the fix as in NMEA GGA, 0: none.", _PORT + "quality"),
    Metric("imud_fix_age_seconds", _GAUGE, "Since the last fix.", _PORT + "fix_age_s"),
    Metric("imud_filter_state", _GAUGE, "1: the filter is in this state.", r"filter\.flags\.(?P<state>.+)"),
    Metric(
        "imud_attitude_sigma_degrees", _GAUGE, "Standard deviation.", r"filter\.s(?P<angle>roll|pitch|yaw)_deg",
    ),
    Metric("imud_position_sigma_meters", _GAUGE, "Standard deviation.", r"filter\.s(?P<axis>[ned])_m"),
    Metric("imud_velocity_sigma_meters_per_second", _GAUGE, "Standard deviation.", r"filter\.sv(?P<axis>[ned])_mps"),
    Metric("imud_gyro_bias_degrees_per_second", _GAUGE, "Estimate.", r"filter\.bg(?P<axis>[xyz])_dps"),
    Metric("imud_gyro_bias_sigma_degrees_per_second", _GAUGE, "Its deviation.", r"filter\.sbg(?P<axis>[xyz])_dps"),
    Metric("imud_accelerometer_bias_meters_per_second_squared", _GAUGE, "Estimate.", r"filter\.ba(?P<axis>[xyz])_mps2"),
    Metric(
        "imud_accelerometer_bias_sigma_meters_per_second_squared", _GAUGE, "Its deviation.",
        r"filter\.sba(?P<axis>[xyz])_mps2",
    ),
    Metric(
        "imud_innovations_total", _COUNTER, "Innovations that the filter used, and that it rejected.",
        r"innovations\.(?P<kind>\w+)\.(?P<outcome>used|rejected)",
    ),
    Metric(
        "imud_innovation_ratio", _GAUGE, "Mean of innovation^2 / variance over the last fixes; 1 is right.",
        r"innovations\.(?P<kind>\w+)\.ratio",
    ),
    Metric(
        "imud_aiding_measurements_total", _COUNTER, "Measurements of other programs, by source.",
        r"aiding\.sources\.(?P<source>\w+)\.received",
    ),
    Metric(
        "imud_aiding_rate_hertz", _GAUGE, "Measurements per second over ten seconds.",
        r"aiding\.sources\.(?P<source>\w+)\.rate_hz",
    ),
    Metric(
        "imud_aiding_share", _GAUGE, "Of what measurements take off a sigma, the part of this source, 0 to 1.",
        r"aiding\.sources\.(?P<source>\w+)\.share\.(?P<quantity>\w+)",
    ),
    Metric(
        "imud_aiding_late_seconds", _GAUGE, "Age found beyond its epochs.",
        r"aiding\.sources\.(?P<source>\w+)\.late_s",
    ),
    Metric("imud_aiding_scale", _GAUGE, "Scale found of its readings.", r"aiding\.sources\.(?P<source>\w+)\.scale"),
    Metric(
        "imud_aiding_offset_metres", _GAUGE, "Offset found of its heights.",
        r"aiding\.sources\.(?P<source>\w+)\.offset_m",
    ),
    Metric("imud_aiding_age_seconds", _GAUGE, "Since the last one.", r"aiding\.sources\.(?P<source>\w+)\.age_s"),
    Metric(
        "imud_aiding_refused_total", _COUNTER, "Messages that could not be used.", r"aiding\.refused\.(?P<rule>.+)",
    ),
    Metric(
        "imud_aiding_values_refused_total", _COUNTER, "Readings on ports with impossible values.",
        r"aiding\.sources\.(?P<source>\w+)\.refused",
    ),
    Metric("imud_clients", _GAUGE, "Connected clients.", r"outputs\.(?P<output>\w+)\.clients"),
    Metric(
        "imud_messages_dropped_total", _COUNTER, "Messages that slow clients lost.",
        r"outputs\.(?P<output>\w+)\.dropped",
    ),
    Metric("imud_gpsd_connections_total", _COUNTER, "Accepted connections.", r"outputs\.gpsd\.connections"),
    Metric("imud_gpsd_refused_total", _COUNTER, "Rejected connections: too many.", r"outputs\.gpsd\.refused"),
    Metric("imud_gpsd_expelled_total", _COUNTER, "Disconnected clients.", r"outputs\.gpsd\.expelled"),
    Metric("imud_gpsd_requests_total", _COUNTER, "Requests.", r"outputs\.gpsd\.requests"),
    Metric("imud_gpsd_errors_total", _COUNTER, "Requests answered with an error.", r"outputs\.gpsd\.errors"),
    *_of_filter_states(),
)  # fmt: skip
CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_INFO = ("path", "driver", "model", "serial", "firmware")


def prometheus(status: Mapping[str, Any]) -> str:
    """The flat status in the text format; a number that no metric names is left out."""
    lines: list[str] = list(_infos(status))
    for metric in METRICS:
        samples = list(_samples(metric, status))
        if samples:
            lines += [f"# HELP {metric.name} {metric.about}", f"# TYPE {metric.name} {metric.kind}", *samples]
    return "\n".join(lines) + "\n"


def _infos(status: Mapping[str, Any]) -> Iterator[str]:
    """The texts, as labels of a metric that is always 1, the convention of Prometheus."""
    yield "# HELP imud_info The daemon."
    yield "# TYPE imud_info gauge"
    yield _sample("imud_info", {"version": status["version"], "estimator": status["filter.estimator"]}, 1)
    yield "# HELP imud_port_info The ports and their devices."
    yield "# TYPE imud_port_info gauge"
    for key in status:
        if match := re.fullmatch(r"ports\.(\d+)\.path", key):
            labels = {name: status.get(f"ports.{match[1]}.{name}", "") for name in _INFO}
            yield _sample("imud_port_info", {"port": labels.pop("path"), **labels}, 1)


def _samples(metric: Metric, status: Mapping[str, Any]) -> Iterator[str]:
    for key, value in status.items():
        if match := re.fullmatch(metric.pattern, key):
            labels = match.groupdict()
            if "port" in labels:
                labels["port"] = status[f"ports.{labels['port']}.path"]
            yield _sample(metric.name, labels, value * metric.scale)


def _sample(name: str, labels: Mapping[str, str], value: float) -> str:
    text = ",".join(f'{key}="{_escaped(label)}"' for key, label in labels.items())
    return f"{name}{{{text}}} {value:.12g}" if text else f"{name} {value:.12g}"


def _escaped(label: str) -> str:
    return label.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
