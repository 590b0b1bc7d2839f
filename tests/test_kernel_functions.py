"""A kernel keeps its function only where that cannot be made again from its module's byte code."""

import importlib
import sys

import pytest

from imud.drivers.jit import interpreted, kernel

MODULE = '''
"""A user's module."""
from imud.drivers.jit import kernel, unrolled

LEAST = 3

@kernel
def double(x):
    """Twice x."""
    return 2 * x

@unrolled
def limited(x):
    return max(double(x), LEAST)

@kernel
def with_default(x, y=4):
    return x + y
'''


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "kernels_of_a_user.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("kernels_of_a_user")
    del sys.modules["kernels_of_a_user"]


def test_a_module_s_function_is_made_again_when_asked_for(module):
    assert "py_func" not in vars(module.limited)
    assert module.double.py_func(4) == 8
    assert module.double.py_func.__doc__ == "Twice x."
    assert interpreted(module.limited)(1) == 3
    assert interpreted(module.limited)(5) == 10
    assert module.double.py_func is module.double.__wrapped__
    assert module.limited.name == "kernels_of_a_user.limited"


def test_functions_that_byte_code_does_not_have_whole_are_kept(module):
    factor = 3

    @kernel
    def scaled(x):
        return factor * x

    assert scaled.py_func(2) == 6
    assert vars(module.with_default)["py_func"](1) == 5


def test_a_file_that_has_changed_meanwhile_is_named(module, tmp_path):
    (tmp_path / "kernels_of_a_user.py").write_text("# one more line\n" + MODULE)
    with pytest.raises(ImportError, match=r"kernels_of_a_user\.limited is no longer in line \d+: its file has changed"):
        _ = module.limited.py_func
