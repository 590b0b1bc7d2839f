"""The C that `imud bench` compares with does the same work: same bytes, same fixes, same numbers."""

import numpy as np
import pytest

from drivers.driver import Identity, ImuConfigured
from drivers.registry import by_name
from imud.bench import reference, signals
from imud.estimators import registry
from imud.estimators.records import INNOVATION, SOLUTION
from imud.pipeline import BATCH, Filter, Stream
from imud.replay import play
from imud.settings import Initial, Settings

SECONDS = 20


@pytest.fixture(scope="module", autouse=True)
def compiler():
    try:
        return reference.compiler()
    except reference.NoReferenceError as error:
        pytest.skip(str(error))


def filter_of(name):
    return Filter(registry.by_name(name), Settings(), Initial(), float(signals.RATE_HZ))


def play_c(filter_, library, samples, fixes):
    """What `imud.replay.play` does, with the C functions."""
    out = np.zeros(len(samples), SOLUTION)
    innovations = np.zeros(16, INNOVATION)
    places = np.searchsorted(samples["t_ns"], fixes["arrival_ns"], side="left")
    start = 0
    for place, fix in [*zip(places, fixes, strict=True), (len(samples), None)]:
        part = slice(start, place)
        reference.call(library.run, samples[part], filter_.mount, filter_.parameters, filter_.state, out[part])
        if fix is not None and 0 < place < len(samples) and filter_.estimator.update:
            record = np.array([fix], fixes.dtype)
            records = [reference.pointer(r) for r in (filter_.parameters, filter_.state, record)]
            reference.call(library.update, *records, innovations)
        start = place
    return out


def assert_same(ours, theirs):
    assert np.array_equal(ours["status"], theirs["status"])
    assert np.array_equal(ours["t_ns"], theirs["t_ns"])
    for name in SOLUTION.names[2:]:
        scale = np.nanmax(np.abs(ours[name]), initial=1e-3)
        np.testing.assert_allclose(theirs[name], ours[name], rtol=0.0, atol=1e-9 * scale, err_msg=name)


@pytest.mark.parametrize("name", registry.NAMES)
def test_an_estimator_in_c_gives_the_same_solutions(tmp_path, name):
    samples, fixes = signals.samples(SECONDS * signals.RATE_HZ), signals.fixes(SECONDS)
    ours, theirs = filter_of(name), filter_of(name)
    rows = []
    play(ours, samples.copy(), fixes, lambda out: rows.append(out.copy()), np.ones(len(samples), bool))
    solutions = np.concatenate(rows)
    library = reference.build(reference.source(theirs), tmp_path)
    assert_same(solutions, play_c(theirs, library, samples.copy(), fixes))
    assert np.isfinite(solutions["q_nb"][-1]).all() or np.isfinite(solutions["v"][-1]).any()


def test_the_whole_path_from_bytes_in_c_gives_the_same_solutions(tmp_path):
    driver = by_name("epson")
    configured = ImuConfigured(Identity("epson", "M-G350"), 1000.0, 1_000_000, 700_000, signals.FRAME)
    streams = [Stream(driver.decode, driver.new_state(configured), filter_of("attitude")) for _ in range(2)]
    for stream in streams:
        stream.restart(driver.new_state(configured), 1e6, 7e5)
    ours, theirs = streams
    library = reference.build(reference.source(theirs.filter, driver.decode, theirs.decoder), tmp_path)
    wire = signals.frames(SECONDS * signals.RATE_HZ).tobytes()
    wire = wire[:5000] + b"junk\r" + wire[5000:90_000] + wire[91_001:]
    rng = np.random.default_rng(2)
    at, got = 0, 0
    while at < len(wire):
        chunk = wire[at : at + int(rng.integers(1, 200))]
        at += len(chunk)
        arrival_ns = 10**9 + at * 1_000_000 // signals.FRAME + int(rng.integers(0, 100_000))
        for stream in streams:
            stream.rx[stream.fill : stream.fill + len(chunk)] = np.frombuffer(chunk, np.uint8)
        n = ours.ingest(len(chunk), arrival_ns)
        filled = theirs.fill + len(chunk)
        m = reference.call(library.decode, theirs.rx, filled, theirs.decoder, theirs.samples)
        theirs.fill = int(theirs.decoder["leftover"][0])
        f = theirs.filter
        arguments = (m, arrival_ns, theirs.clock, f.mount, f.parameters, f.state, theirs.solutions)
        reference.call(library.advance, theirs.samples, *arguments)
        assert m == n <= BATCH
        assert_same(ours.solutions[:n], theirs.solutions[:n])
        got += n
    assert got > 0.98 * SECONDS * signals.RATE_HZ
    assert ours.decoder["lost"][0] == theirs.decoder["lost"][0] > 0


def test_what_is_not_understood_is_named_with_its_place():
    translate = reference.translator()

    def strange(a: float) -> float:
        del a

    with pytest.raises(translate.UnsupportedError, match=r"test_c_reference\.py:\d+: statement: del a"):
        translate.Translation().function(strange, [translate.FLOAT])
