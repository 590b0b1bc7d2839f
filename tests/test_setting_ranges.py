"""Every number from outside has a finite range and a unit in its schema; within it everything works, beyond it nothing.

The values come from the schema itself, so that a setting added tomorrow is tested as well.
"""

import math
import re
import select
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imud.clocks.epochs import EpochClock
from imud.configuration.schema import Key, choices_of, keys, kind_of, split
from imud.configuration.settings import Initial, Settings
from imud.errors import ConfigError
from imud.estimators import registry
from imud.estimators.records import FIX, SOLUTION
from imud.outputs.all import Outputs
from imud.outputs.gpsd_dialogue import _WatchArgument
from imud.pipeline import Filter
from imud.recording.thinner import Thinner
from imud.setup import config

SECOND = 1_000_000_000
KEYS = list(keys())


def numbers_in(hint: Any, where: str) -> list[tuple[str, msgspec.Meta | None]]:
    """The place of every number that a type admits, with what its schema says of it."""
    bare, meta = split(hint)
    if bare in (int, float):
        return [(where, meta if get_origin(hint) is Annotated else None)]
    if get_origin(bare) is dict:  # of tunables, which have a table of their own
        return []
    parts = choices_of(bare) if choices_of(bare) != [bare] else get_args(bare) if get_origin(bare) is tuple else ()
    return [found for part in parts if part is not Ellipsis for found in numbers_in(part, where)]


def all_numbers() -> list[tuple[str, msgspec.Meta | None]]:
    found = [number for key in KEYS for number in numbers_in(key.hint, key.path)]
    for schema in (Initial, _WatchArgument):
        for name, hint in get_type_hints(schema, include_extras=True).items():
            found += numbers_in(hint, f"{schema.__name__}.{name}")
    return found


def test_every_number_has_a_finite_range_and_a_unit():
    found = all_numbers()
    assert len(found) > 45
    for where, meta in found:
        assert meta is not None and "unit" in meta.extra, where
        least, most = meta.extra["least"], meta.le
        assert math.isfinite(least) and math.isfinite(most) and least < most, where


def test_every_text_forbids_control_characters():
    for key in KEYS:
        bare, meta = split(key.hint)
        if bare is str:
            assert meta.pattern and not re.search(meta.pattern, "a:b\n") and meta.max_length, key.path


def valid(hint: Any) -> st.SearchStrategy:
    """Values of this type, above all the ends of its range; None where only a name would do."""
    bare, meta = split(hint)
    if choices_of(bare) != [bare]:
        return st.one_of(map(valid, choices_of(bare)))
    if bare in (int, float):
        least, most = meta.extra["least"], meta.le
        inside = st.integers(least, most) if bare is int else st.floats(least, most, allow_nan=False)
        ends = [least, most, *([0] if meta.extra["or_zero"] else [])]
        return st.sampled_from(ends) | inside
    if bare is bool:
        return st.booleans()
    if get_origin(bare) is Literal:
        return st.sampled_from(get_args(bare))
    if get_origin(bare) is tuple and split(get_args(bare)[0])[0] is not str:
        items = get_args(bare)
        if items[-1] is Ellipsis:
            return st.lists(valid(items[0]), max_size=min(8, meta.max_length))
        return st.tuples(*map(valid, items)).map(list)
    return st.none()


def table_of(values: dict[str, Any]) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for path, value in values.items():
        if value is not None:
            name, _, key = path.rpartition(".")
            (table.setdefault(name, {}) if name else table)[key] = value
    return table


anything_valid = st.fixed_dictionaries({}, optional={key.path: valid(key.hint) for key in KEYS})
extremes = [
    pytest.param(key, end, id=f"{key.path}={end:g}")
    for key in KEYS
    for end in {
        end
        for _, meta in numbers_in(key.hint, key.path)
        for end in (meta.extra["least"], meta.le)
        if "list" not in key.kind
    }
]
tunables = [(registry.by_name(name), tunable) for name in registry.NAMES for tunable in registry.by_name(name).tunables]


def settings_of(values: dict[str, Any]) -> Settings:
    return config.from_table(table_of(values), [], "test")


def computed(chosen: Settings, name: str, rate_hz: float) -> None:
    """The estimator's parameters and first state are finite, and no variance has vanished."""
    estimator = registry.by_name(name)
    parameters = estimator.configure(chosen, rate_hz)
    for field in parameters.dtype.names:
        if parameters[field].dtype.names is None:
            values = np.asarray(parameters[field], float)
            assert np.isfinite(values).all(), (name, field)
            assert not field.endswith(("_psd", "_var", "_walk")) or (values > 0.0).all(), (name, field)
    state = estimator.start(parameters, Initial())
    assert state.shape == (1,)


@given(anything_valid, st.sampled_from([0.1, 125.0, 2000.0]))
@settings(max_examples=100)
def test_any_valid_settings_configure_every_estimator(values, rate_hz):
    chosen = settings_of(values)
    for name in registry.NAMES:
        computed(chosen, name, rate_hz)


@pytest.mark.parametrize(("key", "end"), extremes)
def test_the_end_of_a_range_serves_every_part_of_the_daemon(key: Key, end: float):
    chosen = settings_of({key.path: end})
    for name in registry.NAMES:
        computed(chosen, name, 125.0)
    gpsd = msgspec.structs.replace(chosen.gpsd, listen="127.0.0.1:0")
    nmea = msgspec.structs.replace(chosen.nmea, udp="127.0.0.1:9")
    chrony = msgspec.structs.replace(chosen.chrony, shm_unit=-1)  # its segment would outlive the test
    outputs = Outputs(msgspec.structs.replace(chosen, gpsd=gpsd, nmea=nmea, chrony=chrony), select.poll(), 16, {}, {})
    try:
        from imud.outputs.view import View

        for now_ns in (SECOND, 2 * SECOND, 4000 * SECOND):
            assert outputs.due_ns < 1 << 63
            outputs.publish(View, now_ns)
            outputs.tick(now_ns)
    finally:
        outputs.close()
    assert EpochClock(chosen.gnss.latency_s).epoch_ns(5.0, 20 * SECOND) <= 20 * SECOND
    rows = np.zeros(100, FIX)
    rows["t_ns"] = np.arange(1, 101) * SECOND // 100
    for rate_hz in (chosen.record.sample_rate_hz, chosen.record.estimate_rate_hz):
        assert 1 <= len(Thinner(rate_hz).kept(rows)) <= 100


@given(anything_valid)
@settings(max_examples=8, suppress_health_check=[HealthCheck.too_slow])
@pytest.mark.parametrize("name", ["attitude", "tilt"])
def test_any_valid_settings_give_no_sigma_that_is_not_a_number(name, values):
    """A second of a sensor at rest: an attitude that is called valid has a sigma above zero."""
    from imud.drivers.sample import SAMPLE

    samples = np.zeros(250, SAMPLE)
    samples["t_ns"] = np.arange(250) * 8_000_000
    samples["f"] = (0.0, 0.0, -9.80665)
    samples["f"] += 1e-3 * np.sin(np.arange(750)).reshape(250, 3)
    samples["w"] = 1e-4 * np.cos(np.arange(750)).reshape(250, 3)
    solutions = np.zeros(250, SOLUTION)
    Filter(registry.by_name(name), settings_of(values), Initial(), 125.0).run(samples, solutions)
    valid_rows = solutions[solutions["status"] & 1 != 0]
    assert np.isfinite(valid_rows["q_nb"]).all()
    assert (valid_rows["sigma_rpy"][:, :2] > 0.0).all()


def test_every_tunable_has_a_finite_range_whose_ends_configure_its_estimator():
    assert tunables
    for estimator, tunable in tunables:
        assert math.isfinite(tunable.least) and math.isfinite(tunable.most) and tunable.least < tunable.most, (
            tunable.name
        )
        for end in (tunable.least, tunable.most):
            chosen = config.loads("", [f"{estimator.table}.tuning.{tunable.name}={end}"])
            with np.errstate(divide="raise", invalid="raise"):
                values = estimator.configure(chosen, 125.0)["tuning"][tunable.name]
            assert values == end, tunable.name


HUGE = [1e300, -1e300, 1e-300, -1e-300, math.inf, -math.inf, math.nan, 10**400, -(10**400), 2**63]


def beyond(key: Key) -> list[Any]:
    """Numbers that this key does not take."""
    (_, meta), *_ = numbers_in(key.hint, key.path)
    zero = meta.extra["or_zero"]
    near = [meta.extra["least"] * 0.5 if zero else meta.extra["least"] - 1, meta.le + 1]
    outside = [n for n in [*HUGE, *near] if not (meta.extra["least"] <= n <= meta.le or (zero and n == 0))]
    return [[n, n, n] for n in outside] if key.kind.startswith("list") else outside


@pytest.mark.parametrize("key", [key for key in KEYS if numbers_in(key.hint, key.path)], ids=lambda key: key.path)
def test_beyond_its_range_a_number_is_refused_with_key_range_and_unit(key):
    (_, meta), *_ = numbers_in(key.hint, key.path)
    for value in beyond(key):
        with pytest.raises(ConfigError) as error:
            settings_of({key.path: value})
        assert error.value.exit_code == 78
        message = str(error.value)
        assert f"{key.path}: must be {kind_of(key.hint)[0]}" in message
        assert f"from {meta.extra['least']:.9g} to {meta.le:.9g} {meta.extra['unit']}".rstrip() in message


toml_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.dates() | st.datetimes() | st.times(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=8,
)


@given(st.dictionaries(st.sampled_from([key.path for key in KEYS]) | st.text(), toml_values, max_size=4))
def test_any_table_gives_settings_or_a_configuration_error(values):
    try:
        assert isinstance(settings_of(values), Settings)
    except ConfigError as error:
        assert error.exit_code == 78


@given(st.sampled_from([key.path for key in KEYS]) | st.text(), st.text())
def test_any_override_gives_settings_or_a_configuration_error(key, value):
    try:
        assert isinstance(config.load(None, [f"{key}={value}"]), Settings)
    except ConfigError as error:
        assert error.exit_code == 78


@pytest.mark.parametrize(
    "text",
    [
        "x = " + "[" * 100_000,
        "x = " + "{a=" * 50_000,
        "filter_taps = " + "9" * 5000,
        "[" + "a." * 20_000 + "b]",
        "a." * 50_000 + "b = 1",
        "\n".join(f"k{i} = 1" for i in range(20_000)),
        "imu = " + "'" * 3 + "x" * 100_000,
        "\ufeff\ufeffx = 1",
    ],
    ids=["arrays", "tables", "digits", "dotted", "dotted key", "keys", "string", "marks"],
)
def test_a_hostile_file_is_a_configuration_error(text, tmp_path):
    file = tmp_path / "hostile.toml"
    file.write_text(text)
    with pytest.raises(ConfigError) as error:
        config.load(file)
    assert len(str(error.value)) < 20_000


def test_an_endless_file_is_not_read_to_its_end():
    with pytest.raises(ConfigError, match="longer than 256 KiB"):
        config.load(Path("/dev/urandom"))
    with pytest.raises(ConfigError, match="longer than 256 KiB"):
        config.load(Path("/dev/zero"))


def test_options_of_the_command_line_are_held_to_the_same_rules():
    with pytest.raises(ConfigError, match=r"gpsd\.listen: must be text without control characters"):
        config.load(None, [], {"gpsd.listen": "127.0.0.1\n"})
    for port in ("/dev/" + "x" * 5000, "/dev/\udcff"):
        with pytest.raises(
            ConfigError, match="ports: must be list: text without control characters, in UTF-8, at most"
        ):
            config.load(None, [], {"ports": [port]})
