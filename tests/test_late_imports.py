"""Modules that are imported at their first use: who uses one finds all of it, and nobody pays for it before."""

import subprocess
import sys

import pytest

from imud.__main__ import _SELDOM_USED
from imud.late_imports import imported_late


def output_of(code):
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    return done.stdout.split()


def test_what_was_imported_before_stays():
    with imported_late("json"):
        import json
    assert json is sys.modules["json"] and json.loads("1") == 1


def test_a_stand_in_is_gone_after_the_block_and_still_works():
    code = """
import sys
from imud.late_imports import imported_late
with imported_late("colorsys", "wave"):
    import colorsys
    from wave import Wave_read
    print(hasattr(sys.modules["colorsys"], "__file__"), "wave" in sys.modules)
print(colorsys.rgb_to_hsv(1, 0, 0)[0], Wave_read.__module__)
import colorsys as again
print(again.__name__, type(again).__name__)
"""
    assert output_of(code) == ["True", "True", "0.0", "wave", "colorsys", "module"]


def test_modules_within_a_late_package_can_be_imported():
    code = """
from imud.late_imports import imported_late
with imported_late("asyncio", "xml"):
    import asyncio.events
    import xml.dom.minidom
print(asyncio.events.__name__, xml.dom.minidom.parseString("<a/>").documentElement.tagName)
"""
    assert output_of(code) == ["asyncio.events", "a"]


def test_hidden_is_what_was_not_imported_before_and_within_the_block_only():
    code = """
import json
from imud.late_imports import hidden
with hidden("json", "colorsys", "no_such_package"):
    import json.decoder
    try:
        import colorsys
    except ImportError as error:
        print(error.name)
import colorsys
print(colorsys.__name__)
"""
    assert output_of(code) == ["colorsys", "colorsys"]


def test_numpy_comes_without_what_only_formats_its_documentation_and_works():
    code = """
import sys
from imud.late_imports import imported_late, undocumented
with imported_late("ast", "inspect"):
    with undocumented():
        import numpy
    print({name for name in ("inspect", "ast", "dis") if type(sys.modules.get(name)) is type(sys)})
    import inspect  # by another, within the same command
print(inspect.signature(lambda whatever: 0), numpy.zeros(2, "i4,(2,)f8").itemsize)  # the comma needs `ast`
"""
    assert output_of(code) == ["set()", "(whatever)", "20"]


def test_numpy_has_its_documentation_where_inspect_is_there_anyway():
    code = """
import inspect
from imud.late_imports import undocumented
with undocumented():
    import numpy
print(len(numpy.concatenate.__doc__) > 100, inspect.signature(lambda whatever: 0))
"""
    assert output_of(code) == ["True", "(whatever)"]


@pytest.mark.parametrize(
    "arguments",
    [
        ("--version",),
        ("--help",),
        ("metrics",),  # a command that there is not
        ("probe",),
        ("probe", "--help"),
        ("status", "--help"),
        ("status", "/absent"),
        ("web", "--help"),
        ("foxglove", "--help"),
        ("completion", "--help"),
    ],
    ids=" ".join,
)
def test_a_command_that_shows_something_small_loads_only_pythons_own_modules(arguments, tmp_path):
    code = f"""
import os, sys
os.environ["IMUD_IIO_ROOT"] = {str(tmp_path)!r}
sys.argv = ["imud", *{arguments!r}]
from imud.__main__ import main
from imud.commands import probe
probe.candidates = list
heavy = {{"numpy", "numba", "msgspec", "structlog", "serial", "typing_extensions"}}
try:
    main()
finally:
    print("imported", *(heavy & set(sys.modules)))
"""
    assert output_of(code)[-1] == "imported"


def test_a_daemon_imports_none_of_them():
    code = f"""
import sys
imported = set(sys.modules)  # by `python -c`: linecache since Python 3.13
if sys.version_info >= (3, 12):
    imported.add("inspect")  # dataclasses use it there
sys.argv = ["imud", "run", "--port", "/dev/absent", "--no-wait", "--listen", "127.0.0.1:0"]
from imud.__main__ import main
unwanted = {{*{_SELDOM_USED}, "rich", "typing_extensions", "imud.estimators.tilt"}} - imported
print(main(), "imud.daemon.loop" in sys.modules, *(unwanted & set(sys.modules)))
"""
    assert output_of(code) == ["69", "True"]


def test_a_daemon_is_ready_before_any_driver_is_imported():
    """None is needed before a device is looked for."""
    code = """
import os, sys
sys.argv = ["imud", "run", "--port", "/dev/absent", "--listen", "127.0.0.1:0"]
from imud.__main__ import main
from imud.process.notify import Notifier
def send(notifier, *assignments):
    if "READY=1" in assignments:
        print("ready", *(name for name in sys.modules if name.endswith(".driver") and name != "imud.drivers.driver"))
        sys.stdout.flush()
        os._exit(0)
Notifier.send = send
main()
"""
    assert output_of(code) == ["ready"]
