"""The C that `imud bench` compares with does the same work: same bytes, same fixes, same numbers."""

import ctypes

import numpy as np
import pytest

from imud.batch import play
from imud.commands.bench import reference, signals
from imud.commands.bench.throughput import CReplay, attitude_pipeline
from imud.configuration.settings import Initial, Settings
from imud.estimators import registry
from imud.estimators.records import SOLUTION
from imud.pipeline import Filter

SECONDS = 20

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module", autouse=True)
def compiler():
    try:
        return reference.compiler()
    except reference.NoReferenceError as error:
        pytest.skip(str(error))


def filter_of(name):
    return Filter(registry.by_name(name), Settings(), Initial(), float(signals.RATE_HZ))


def content(address, like):
    """The array at an address that a C function gives."""
    address.restype = ctypes.c_void_p
    return np.frombuffer(ctypes.string_at(address(), like.nbytes), like.dtype)


def assert_same(ours, theirs):
    assert np.array_equal(ours["status"], theirs["status"])
    assert np.array_equal(ours["t_ns"], theirs["t_ns"])
    for name in SOLUTION.names[2:]:
        scale = np.nanmax(np.abs(ours[name]), initial=1e-3)
        np.testing.assert_allclose(theirs[name], ours[name], rtol=0.0, atol=1e-9 * scale, err_msg=name)


@pytest.fixture(scope="module")
def in_c(compiler, tmp_path_factory):
    """A filter of each estimator, by its name."""
    filters = {name: filter_of(name) for name in registry.NAMES}
    reference.to_c(list(filters.values()), tmp_path_factory.mktemp("filters"))
    return filters


@pytest.mark.parametrize("name", registry.NAMES)
def test_an_estimator_in_c_gives_the_same_solutions(in_c, name):
    samples, fixes = signals.samples(SECONDS * signals.RATE_HZ), signals.fixes(SECONDS)
    solutions = []
    for filter_ in (filter_of(name), in_c[name]):
        rows = []
        play(filter_, samples.copy(), fixes, lambda out, rows=rows: rows.append(out.copy()))
        solutions.append(np.concatenate(rows))
    assert_same(*solutions)
    last = solutions[0][-1]
    assert np.isfinite(last["q_nb"]).all() or np.isfinite(last["v"]).any()


def test_the_whole_path_from_bytes_in_c_gives_the_same_solutions(tmp_path):
    frames = signals.frames(SECONDS * signals.RATE_HZ)
    wire = frames.tobytes()
    wire = np.frombuffer(wire[:5000] + b"junk\r" + wire[5000:90_000] + wire[91_001:], np.uint8).copy()
    pipeline = attitude_pipeline()
    text, memory = reference.pipeline_source(pipeline)
    export = "void *decoder(void) { return DECODER; }\nvoid *solutions(void) { return SOLUTIONS; }\n"
    (tmp_path / "main.c").write_text((reference.SOURCES / "replay.c").read_text() + export)
    library = reference.build(text, tmp_path, tmp_path / "main.c")
    for chunk in (7, 22, 1000):
        begin = ctypes.c_char_p(memory)
        theirs = reference.call(library.replay, reference.pointer(wire), len(wire), chunk, 45_454, begin)
        pipeline = attitude_pipeline()
        total = 0
        for at in range(0, len(wire), chunk):
            part = wire[at : at + chunk]
            pipeline.rx[pipeline.fill : pipeline.fill + len(part)] = part
            n = pipeline.ingest(len(part), (at + len(part)) * 45_454)
            total += n
        assert theirs == total > 0.98 * len(frames)
        assert_same(pipeline.solutions[:n], content(library.solutions, pipeline.solutions)[:n])
        in_c = content(library.decoder, pipeline.decoder)
        for counter in ("frames", "junk", "bad", "lost", "suspect", "errors"):
            assert in_c[counter] == pipeline.decoder[counter], counter
        assert pipeline.decoder["lost"][0] > 0


def test_an_installed_imud_reports_that_there_is_no_c_to_compare_with(monkeypatch, tmp_path):
    """As it did not: `imud bench` from an installation ended with a traceback."""
    monkeypatch.setattr(reference, "SOURCES", tmp_path / "tests" / "c")
    with pytest.raises(reference.NoReferenceError, match="checkout"):
        CReplay(tmp_path)
