"""What `imud bench` makes of figures: verdicts, and a reason beside every goal that is missed. No times."""

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from imud.batch import play
from imud.commands import bench
from imud.commands.bench import aided, signals, table, throughput
from imud.configuration.settings import Initial, Settings
from imud.estimators import registry
from imud.estimators.records import MAGNETOMETER_SOURCE
from imud.pipeline import Filter

SOURCES = Path(table.__file__).parent


def section():
    made = table.Section("Things")
    made.add("good", 1.0, "x", most=1.5, reason="never shown")
    made.add("bad", 2.0, "x", most=1.5, note="C: 1", reason="of the weather")
    made.add("slow", 2.0, "x", least=3.0, reason="of the wind")
    made.add("absent", float("nan"), "x", most=1.5, note="no compiler", reason="never shown")
    return made


def test_a_missed_goal_has_its_reason_beside_it():
    text = table.as_text([section()])
    assert text.splitlines()[2].endswith("MISSED: C: 1")
    assert text.splitlines()[3].strip() == "because of the weather"
    assert text.splitlines()[5].strip() == "because of the wind"
    assert "never shown" not in text
    assert "not measured: no compiler" in text


def test_so_it_has_in_json():
    figures = {f["name"]: f for f in json.loads(table.as_json([section()]))["figures"]}
    assert [figures[name]["reason"] for name in ("good", "bad", "slow", "absent")] == [
        "", "of the weather", "of the wind", "",
    ]  # fmt: skip
    assert figures["bad"]["verdict"] == "MISSED"
    assert figures["absent"]["value"] is None


@pytest.mark.parametrize("path", sorted(SOURCES.glob("*.py")), ids=lambda path: path.stem)
def test_no_goal_is_without_a_reason(path):
    calls = re.findall(r"section\.add\((.*(?:most|least)=.*)\)$", path.read_text(), re.MULTILINE)
    assert [call for call in calls if "reason=" not in call and "nan" not in call] == []


def test_what_is_started_keeps_its_bytecode(monkeypatch, tmp_path, capsys):
    """Else each start compiles all modules, which takes longer and leaves holes in the memory."""
    (tmp_path / "module.py").write_text("")
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")

    def start():
        subprocess.run([sys.executable, "-c", "import module"], check=True, cwd=tmp_path)
        return table.Section("Start")

    monkeypatch.setattr(bench, "_parts", lambda quick: [("start", start)])
    bench.run(argparse.Namespace(quick=True, json=False))
    assert list((tmp_path / "__pycache__").glob("module.*.pyc"))


def test_every_measurement_of_an_aiding_source_is_fused_once_under_way():
    """One that the filter leaves out would cost nothing: a barometer that never changes did."""
    seconds, under_way_ns = 40, 20_000_000_000
    known = [s for s in registry.by_name("navigation").sources if s.kind != MAGNETOMETER_SOURCE]  # as the bench
    assert len(known) == 6
    for source in known:
        filter_, found = Filter(registry.by_name("navigation"), Settings(), Initial(), float(signals.RATE_HZ)), []
        rows = signals.measurements(seconds, source.kind)
        play(
            filter_,
            signals.samples(seconds * signals.RATE_HZ),
            signals.fixes(seconds),
            lambda rows: None,
            on_innovations=found.append,
            aiding=rows,
        )
        innovations = np.concatenate(found)
        late = innovations["t_ns"] > under_way_ns
        fused = innovations["used"][late & np.isin(innovations["kind"], list(source.innovations))].sum()
        assert fused >= 0.95 * np.sum(rows["t_ns"] > under_way_ns), source.name


def test_sources_are_timed_once_the_filter_is_aligned(monkeypatch):
    played, timed = [], []

    def play(filter_, samples, fixes, on_solutions, aiding):
        played.append((samples["t_ns"], fixes["arrival_ns"], aiding["arrival_ns"]))

    def time(act):
        act()
        timed.append(played[-1])
        return 1.0

    monkeypatch.setattr(aided, "play", play)
    monkeypatch.setattr(aided, "timed", time)
    aided.aiding(2, 1)
    assert len(played) == 2 * len(timed)
    for times, fixes, measurements in timed:
        assert (times[0], len(times)) == (throughput.START_S * 1_000_000_000, 2 * signals.RATE_HZ)
        assert min([*fixes, *measurements]) >= times[0]
        assert len(fixes)
