"""The release script fails where the packages that imud needs were not audited, or where one is vulnerable."""

import importlib.util

import pytest
from release import audit

PARTS = {"components": [{"name": "imud", "version": "0.2.0"}, {"name": "numpy", "version": "2.0.0"}]}
PIP_AUDIT = """
import sys
from pathlib import Path

needed = Path(sys.argv[sys.argv.index("-r") + 1]).read_text().split()
sys.exit("--strict" not in sys.argv or needed != ["numpy==2.0.0"] or {vulnerable})
"""


def test_without_pip_audit_it_fails(monkeypatch, capsys):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert audit(PARTS) != 0
    assert capsys.readouterr().out.startswith("NOT audited")


@pytest.mark.parametrize("vulnerable", [False, True])
def test_it_asks_for_what_imud_needs_and_believes_the_answer(tmp_path, monkeypatch, vulnerable):
    (tmp_path / "pip_audit.py").write_text(PIP_AUDIT.format(vulnerable=vulnerable))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert (audit(PARTS) != 0) is vulnerable
