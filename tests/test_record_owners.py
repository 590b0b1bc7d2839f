"""Each field of both filters' records is written by one file; the others read it."""

import ast
from collections import defaultdict
from pathlib import Path

import pytest

import imud.estimators

ESTIMATORS = Path(imud.estimators.__file__).parent
# the two halves of a Kalman filter: what is propagated by the one and corrected by the other
SHARED = {
    "nav": {"mechanization.py", "error_model.py", "ekf.py"},
    "cov": {"error_model.py", "ekf.py"},
}
BEGUN_ANEW = {  # states of one measurement or constraint, whose file may set them to zero or as given
    ("nav", "gnss_bias"): "aiding/gnss_noise.py",
    ("nav", "gnss_lever_arm"): "aiding/lever_arm_prior.py",
    ("nav", "time_offset"): "aiding/gnss_time.py",
    ("nav", "velocity_time_offset"): "aiding/gnss_time.py",
    ("nav", "nhc_lever_arm"): "vehicle_axes.py",
    ("nav", "velocity_mount"): "boresights.py",
    ("cov", "boresight"): "boresights.py",  # of states outside P
    ("cov", "boresight_covariance"): "boresights.py",
}
CORE = "cs"  # what the functions call the state that the records belong to
# kernels of imud.math.kalman that write their first argument
MATH = ("reset", "scale", "shear", "shear3", "shear33", "update")


def chain(node):
    """c.nav.v_n[0] -> ["c", "nav", "v_n"]; for locals that stand for a record see `aliases`."""
    names = []
    while isinstance(node, ast.Attribute | ast.Subscript):
        if isinstance(node, ast.Attribute):
            names.append(node.attr)
        node = node.value
    return [node.id, *reversed(names)] if isinstance(node, ast.Name) else []


def is_core(names):
    """Does the chain begin with the state?"""
    return bool(names) and names[0] in CORE


def targets_of(node):
    """What a statement writes."""
    if isinstance(node, ast.Assign):
        for target in node.targets:
            yield from target.elts if isinstance(target, ast.Tuple) else [target]
    elif isinstance(node, ast.AugAssign | ast.AnnAssign):
        yield node.target
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in MATH:
        yield node.args[0]


def aliases(function):
    """Locals of a function that stand for a record or a field of the core: name to its chain."""
    found = {}
    for node in ast.walk(function):
        if isinstance(node, ast.Assign) and len(node.targets) == 1:
            target, value = node.targets[0], node.value
            pairs = [(target, value)]
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                pairs = list(zip(target.elts, value.elts, strict=True))
            for name, what in pairs:
                if isinstance(name, ast.Name) and isinstance(what, ast.Attribute) and is_core(chain(what)):
                    found[name.id] = chain(what)
    return found


def writers(folder):
    """(record, field) to the files that write it."""
    found = defaultdict(set)
    for path in folder.rglob("*.py"):
        for function in (n for n in ast.parse(path.read_text()).body if isinstance(n, ast.FunctionDef)):
            known = aliases(function)
            for node in ast.walk(function):
                for target in targets_of(node):
                    names = chain(target)
                    if not names or (
                        isinstance(target, ast.Name) and names[0] in known and isinstance(node, ast.Assign)
                    ):
                        continue
                    full = known.get(names[0], names[:1]) + names[1:]
                    if is_core(full) and len(full) > 2:
                        found[full[1], full[2]].add(path.relative_to(folder).as_posix())
    return found


@pytest.mark.parametrize(("estimator", "least_fields"), [("ins", 90), ("ahrs", 70)])
def test_each_field_is_written_by_one_file(estimator, least_fields):
    found = writers(ESTIMATORS / estimator)
    assert len(found) > least_fields
    several = {field: files for field, files in found.items() if len(files) > 1 and field[0] != "scratch"}
    allowed = {field: SHARED.get(field[0], set()) | {BEGUN_ANEW.get(field, "")} for field in several}
    assert {field: files for field, files in several.items() if not files <= allowed[field]} == {}


def test_a_second_writer_is_seen(tmp_path):
    (tmp_path / "a.py").write_text("def f(c):\n    c.nav.lat = 1.0\n")
    (tmp_path / "b.py").write_text("def g(c):\n    n = c.nav\n    n.lat += 1.0\n")
    assert writers(tmp_path)["nav", "lat"] == {"a.py", "b.py"}
