"""The parts list of a release, and that it is not published if a package is vulnerable, or nobody has looked."""

import hashlib
import importlib.util
import zipfile

import pytest
from parts_list import defect, parts_list
from release import audit

PARTS = {"components": [{"name": "numpy", "version": "2.0.0"}, {"name": "spidev"}]}
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
def test_it_asks_for_what_imud_needs_and_believes_the_answer(tmp_path, monkeypatch, capsys, vulnerable):
    (tmp_path / "pip_audit.py").write_text(PIP_AUDIT.format(vulnerable=vulnerable))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert (audit(PARTS) != 0) is vulnerable
    assert "not audited: spidev" in capsys.readouterr().out


INSTALLED = {
    "Numbers": "License-Expression: BSD-3-Clause\nRequires-Dist: digits\nRequires-Dist: colours; extra == 'pretty'",
    "digits": "License: Apache 2.0\n        and what its lawyers wrote",
    "web_page": "Classifier: License :: OSI Approved :: MIT License\nRequires-Dist: numbers",
    "tester": "License: MIT",
}
NEEDED = (
    *("Requires-Dist: numbers>=2", "Requires-Dist: pins; platform_machine == 'aarch64'"),
    *("Requires-Dist: registry; sys_platform == 'win32'", "Requires-Dist: web-page; extra == 'web'"),
    *("Requires-Dist: tester; extra == 'test'", "Provides-Extra: web", "Provides-Extra: test"),
)


@pytest.fixture
def wheel(tmp_path, monkeypatch):
    """A wheel, and what is installed beside it."""
    for name, lines in INSTALLED.items():
        (tmp_path / f"{name}-1.5.dist-info").mkdir()
        (tmp_path / f"{name}-1.5.dist-info" / "METADATA").write_text(f"Name: {name}\nVersion: 1.5\n{lines}\n")
    monkeypatch.syspath_prepend(tmp_path)
    path = tmp_path / "imud-0.2.0-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        own = ("Name: imud", "Version: 0.2.0", "License-Expression: MIT", *NEEDED)
        archive.writestr("imud-0.2.0.dist-info/METADATA", "\n".join(own))
    return path


def test_the_wheel_is_the_subject_of_the_parts_list(wheel):
    parts = parts_list(wheel)
    subject = parts["metadata"]["component"]
    assert (subject["name"], subject["version"], subject["licenses"]) == ("imud", "0.2.0", [{"expression": "MIT"}])
    assert subject["hashes"] == [{"alg": "SHA-256", "content": hashlib.sha256(wheel.read_bytes()).hexdigest()}]
    assert "imud" not in [part["name"] for part in parts["components"]]


def test_it_has_what_every_processor_and_every_users_extra_needs_installed_or_not(wheel):
    found = {part["name"]: (part["scope"], part.get("version")) for part in parts_list(wheel)["components"]}
    assert found == {
        "digits": ("required", "1.5"),
        "numbers": ("required", "1.5"),
        "pins": ("required", None),
        "web-page": ("optional", "1.5"),
    }


def test_a_licence_is_an_expression_where_it_is_one(wheel):
    licences = {part["name"]: part.get("licenses") for part in parts_list(wheel)["components"]}
    assert licences == {
        "digits": [{"license": {"name": "Apache 2.0"}}],
        "numbers": [{"expression": "BSD-3-Clause"}],
        "pins": None,
        "web-page": [{"license": {"name": "MIT License"}}],
    }


def test_it_says_which_package_needs_which(wheel):
    needs = {each["ref"]: each["dependsOn"] for each in parts_list(wheel)["dependencies"]}
    assert needs == {
        "pkg:pypi/imud@0.2.0": ["pkg:pypi/numbers@1.5", "pkg:pypi/pins", "pkg:pypi/web-page@1.5"],
        "pkg:pypi/digits@1.5": [],
        "pkg:pypi/numbers@1.5": ["pkg:pypi/digits@1.5"],
        "pkg:pypi/pins": [],
        "pkg:pypi/web-page@1.5": ["pkg:pypi/numbers@1.5"],
    }


@pytest.mark.thorough
def test_it_is_valid_cyclonedx(wheel):
    pytest.importorskip("cyclonedx.validation.json")
    parts = parts_list(wheel)
    assert defect(parts) is None
    parts["components"][0]["licenses"] = [{"license": {"id": "no such licence"}}]
    assert "no such licence" in defect(parts)


def test_without_the_schema_it_is_not_called_valid(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert "cyclonedx-python-lib" in defect({})
