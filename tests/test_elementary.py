"""Sines, logarithms and the like: near the exact value, C's special values, the same bits in C, numba and Python."""

import ctypes
import math

import mpmath
import numpy as np
import pytest

from imud.compile.build import compile_c
from imud.compile.c import Translation
from imud.compile.c.kinds import FLOAT
from imud.compile.jit import interpreted
from imud.drivers import elementary

RANGES = {  # of the arguments, and how many ulp the result may be off
    "sin": ([(-7.0, 7.0), (-1e6, 1e6), (-1e-3, 1e-3)], 1.0),
    "cos": ([(-7.0, 7.0), (-1e6, 1e6), (1.57, 1.5708)], 1.0),
    "tan": ([(-7.0, 7.0), (-1e-3, 1e-3)], 2.0),
    "asin": ([(-1.0, 1.0), (-1e-4, 1e-4)], 2.0),
    "acos": ([(-1.0, 1.0), (0.9999, 1.0)], 2.0),
    "atan": ([(-5.0, 5.0), (-1e6, 1e6), (-0.01, 0.01)], 1.0),
    "atan2": ([(-5.0, 5.0), (-1e-300, 1e300)], 1.5),
    "exp": ([(-1.0, 1.0), (-708.0, 709.7)], 1.0),
    "log": ([(0.0, 10.0), (0.9, 1.1), (0.0, 1e300), (0.0, 1e-310)], 1.0),
    "hypot": ([(-5.0, 5.0), (-1e200, 1e200), (-1e-160, 1e-160)], 2.0),
    "erf": ([(-6.5, 6.5), (-0.01, 0.01)], 10.0),
}
FUNCTIONS = {name: getattr(elementary, name) for name in RANGES}
SPECIAL = (0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, 1e308, -1e308, 5e-324, -5e-324, 2.0, 1e-20)
MANY = 300


def takes(name):
    return 2 if name in ("atan2", "hypot") else 1


@pytest.fixture(scope="module")
def in_c(tmp_path_factory):
    """Each function, compiled by this machine's C compiler."""
    unit = Translation()
    exported = []
    for name, function in FUNCTIONS.items():
        own = unit.function(function, [FLOAT] * takes(name)).name
        names = [f"x{i}" for i in range(takes(name))]
        parameters = ", ".join(f"double {x}" for x in names)
        exported.append(f"double c_{name}({parameters}) {{ return {own}({', '.join(names)}); }}")
    folder = tmp_path_factory.mktemp("elementary")
    (folder / "e.c").write_text(unit.source + "\n".join(exported))
    compile_c(folder / "e.c", folder / "e.so")
    library = ctypes.CDLL(str(folder / "e.so"))
    made = {}
    for name in FUNCTIONS:
        made[name] = getattr(library, f"c_{name}")
        made[name].argtypes, made[name].restype = [ctypes.c_double] * takes(name), ctypes.c_double
    return made


def arguments(name):
    """Random ones of each range, the special ones, and for two arguments all pairs of those."""
    rng = np.random.default_rng(5)
    many = [tuple(x) for low, high in RANGES[name][0] for x in rng.uniform(low, high, (MANY, takes(name))).tolist()]
    special = [(x,) for x in SPECIAL] if takes(name) == 1 else [(x, y) for x in SPECIAL for y in SPECIAL]
    return many, special


@pytest.mark.thorough
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_error_is_within_its_bound(name, in_c):
    exact, bound = getattr(mpmath, name), RANGES[name][1]
    with mpmath.workprec(1200):  # 1e6 rad and ratios of 1e600 included
        for x in arguments(name)[0]:
            value = exact(*(mpmath.mpf(v) for v in x))
            ulp = math.ulp(float(value))
            assert abs(mpmath.mpf(in_c[name](*x)) - value) <= bound * ulp, x


@pytest.mark.parametrize("name", FUNCTIONS)
def test_special_values_are_those_of_the_c_library(name, in_c):
    reference = ctypes.CDLL("libm.so.6")[name]
    reference.argtypes, reference.restype = [ctypes.c_double] * takes(name), ctypes.c_double
    for x in arguments(name)[1]:
        expected, found = reference(*x), in_c[name](*x)
        if name in ("sin", "cos", "tan") and 1e300 < abs(x[0]) < math.inf:
            assert name == "tan" or abs(found) <= 1.0  # its error is unknown, its range is not
        elif math.isnan(expected):
            assert math.isnan(found), x
        else:
            assert found == pytest.approx(expected, rel=2e-15, abs=0.0), x
            assert math.copysign(1.0, found) == math.copysign(1.0, expected), x


@pytest.mark.thorough
@pytest.mark.parametrize("name", FUNCTIONS)
def test_c_numba_and_python_give_the_same_bits(name, in_c):
    function = FUNCTIONS[name]
    plain = interpreted(function)
    for x in [each for group in arguments(name) for each in group]:
        word = np.float64(in_c[name](*x)).tobytes()
        assert np.float64(function(*x)).tobytes() == word or math.isnan(in_c[name](*x)), x
        try:
            with np.errstate(invalid="ignore"):  # fmod of infinity is NaN in each of them; numpy warns as well
                python = plain(*x)
        except (ValueError, ZeroDivisionError, OverflowError):
            continue  # where C gives NaN or infinity, Python may raise
        assert np.float64(python).tobytes() == word or math.isnan(python), x
