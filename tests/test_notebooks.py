"""The notebooks of the manual: each runs, asserts what it claims, and uses nothing of imud but what it exports."""

import importlib.util
import json
import re
from pathlib import Path

import pytest

import imud

if importlib.util.find_spec("nbclient") is None:  # imported where it is used: all workers collect this file
    pytest.skip("the notebooks need nbclient, ipykernel, matplotlib and vqf", allow_module_level=True)

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "docs/notebooks").glob("*.ipynb"))
NOTEBOOK = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
TIMEOUT_S = 600.0  # against hanging


def code(path):
    return [cell for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]


def test_there_are_three():
    assert len(NOTEBOOKS) == 3


@NOTEBOOK
def test_it_is_stored_without_outputs(path):
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in code(path))


@NOTEBOOK
def test_it_uses_only_what_imud_exports(path):
    text = "\n".join("".join(cell["source"]) for cell in code(path))
    assert re.findall(r"^.*import imud.*$|^from imud.*$", text, flags=re.M) == ["import imud"]
    assert set(re.findall(r"\bimud\.(\w+)", text)) <= set(imud.__all__)


@pytest.mark.thorough
@NOTEBOOK
def test_it_runs_and_shows_a_plot(path, tmp_path):
    import nbclient
    import nbformat

    notebook = nbformat.read(path, 4)
    client = nbclient.NotebookClient(
        notebook, timeout=TIMEOUT_S, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()  # raises what a cell raises, an AssertionError of its claims as well
    shown = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in shown)
    assert not any(output.get("name") == "stderr" for output in shown), [o for o in shown if o.get("name") == "stderr"]
