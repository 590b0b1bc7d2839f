"""The library of all kernels: one of other sources, or a damaged one, is never loaded, but built anew."""

import importlib.util
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
from processes import OBEYING
from same_bits import LARGER, digests

from imud.compile import __main__ as translation
from imud.compile import build, levels, library, rebuild, seal
from imud.compile.c import UnsupportedError
from imud.drivers import registry
from imud.errors import UsageError

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def sources(tmp_path):
    """Two files of sources, and a library that is of them."""
    files = ["imud/a.py", "drivers/b.py"]
    for name in files:
        path = tmp_path / name
        path.parent.mkdir()
        path.write_text("RATE = 7.292115e-5\n")
    return tmp_path, files


@pytest.fixture
def sealed(sources, monkeypatch):
    root, files = sources
    digests, drivers = seal.digests, seal.drivers
    monkeypatch.setattr(seal, "digests", lambda files: digests(files, root))
    monkeypatch.setattr(seal, "drivers", lambda: drivers(root))
    path = root / "kernels.so"
    path.write_bytes(Path(sys.executable).read_bytes()[:64] + b"code\nand more")
    seal.seal(path, seal.digests(files), [levels.PLAIN])
    return path


def test_a_library_is_loaded_only_with_the_sources_that_it_was_made_of(sealed):
    assert seal.defect(sealed) is None
    file = sealed.with_name("drivers") / "b.py"
    file.write_text("RATE = 7.292116e-5\n")
    assert seal.defect(sealed) == "is of other sources"
    file.write_text("RATE = 7.292115e-5\n")
    assert seal.defect(sealed) is None
    file.rename(file.with_name("c.py"))
    assert "do not" in seal.defect(sealed)


def test_a_library_without_a_new_driver_is_not_loaded(sealed):
    """Its kernels would be compiled by numba while the sensor's samples wait."""
    driver = sealed.with_name("imud") / "drivers/new/driver.py"
    driver.parent.mkdir(parents=True)
    driver.write_text("DRIVER = None\n")
    assert seal.defect(sealed) == "is of other sources"
    seal.seal(sealed, seal.digests(["imud/a.py", "imud/drivers/new/driver.py"]), [levels.PLAIN])
    assert seal.defect(sealed) is None


def test_a_library_whose_sources_were_edited_while_it_was_built_is_not_loaded(sealed, sources, monkeypatch):
    root, files = sources
    monkeypatch.setattr(translation, "all_sources", lambda: seal.all_sources(root))
    monkeypatch.setattr(translation, "digests", seal.digests)
    monkeypatch.setattr(translation, "loaded_sources", lambda: files[:1])

    def build_it(path, new_text):
        def compile_parts(library, chosen, target):
            (root / files[0]).write_text(new_text)
            library.write_bytes(sealed.read_bytes()[:64])

        monkeypatch.setattr(translation, "_compile_parts", compile_parts)
        monkeypatch.setattr(sys, "argv", ["imud.compile", str(path)])
        assert translation.main() == 0

    before = (root / files[0]).read_text()
    build_it(root / "whole.so", before)
    assert seal.defect(root / "whole.so") is None
    build_it(root / "edited.so", "RATE = 7.3e-5\n")
    assert seal.defect(root / "edited.so") == "is of other sources"
    monkeypatch.setattr(build, "compiler", lambda: ["cc"])
    monkeypatch.setattr(rebuild, "_in_a_process", lambda output: build_it(output, "RATE = 7.4e-5\n"))
    with pytest.raises(UsageError, match="edited while their kernels were compiled: start again"):
        rebuild.rebuild([root / "new.so"])
    assert not (root / "new.so").exists()


def test_the_drivers_of_a_library_are_those_of_the_registry():
    assert {Path(name).parent.name for name in seal.drivers()} == set(registry._folders())


def test_a_damaged_library_is_not_loaded(sealed):
    whole = sealed.read_bytes()
    for damaged in (b"", whole[:-1], whole[:100], whole[5:], b"x" + whole[1:], b"\n{}", b"\n[]", b"\n\xff"):
        sealed.write_bytes(damaged)
        assert seal.defect(sealed) == "is damaged"


@pytest.mark.parametrize(("at", "value"), [(4, 3), (18, 243)])  # a class that is not; RISC-V (elf(5))
def test_a_library_for_another_processor_is_not_loaded(sealed, sources, at, value):
    code = bytearray(sealed.read_bytes().rpartition(b"\n")[0])
    code[at] = value
    sealed.write_bytes(code)
    seal.seal(sealed, seal.digests(sources[1]), [levels.PLAIN])
    assert seal.defect(sealed) == "is for another processor"


def test_a_library_for_processors_with_avx2_is_not_loaded_on_an_older_one(sealed, sources, monkeypatch):
    sealed.write_bytes(sealed.read_bytes().rpartition(b"\n")[0])
    seal.seal(sealed, seal.digests(sources[1]), [levels.AVX2])
    for has, says in (((levels.AVX2, levels.PLAIN), None), ((levels.PLAIN,), "is for processors with AVX2")):
        monkeypatch.setattr(seal, "of_processor", lambda has=has: has)
        assert seal.defect(sealed) == says


def test_a_library_that_is_not_there_or_cannot_be_read(tmp_path):
    assert "does not exist" in seal.defect(tmp_path / "kernels.so")
    assert "directory" in seal.defect(tmp_path)


def test_the_sources_are_those_that_are_loaded(tmp_path, monkeypatch):
    import imud.compile.c
    import imud.stages  # noqa: F401

    files = seal.loaded_sources()
    assert {"imud/stages.py", "imud/math/rotation.py", "imud/compile/c/calls.py", "imud/drivers/sample.py"} <= set(
        files
    )
    assert not any(name.startswith("tests") for name in files)


def run(
    *arguments, code="from imud.commands import main; import sys; sys.exit(main(sys.argv[1:]))", before=(), **variables
):
    environment = {**os.environ, "NO_COLOR": "1", **variables}
    command = [*before, sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment, cwd=ROOT)


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """$CC of a compiler that does not optimize, which takes a fifth of the time; the bits are the same."""
    try:
        command = shlex.join(build.compiler())
    except build.CannotBuildError as error:
        pytest.skip(str(error))
    script = tmp_path_factory.mktemp("compiler") / "cc"
    script.write_text(f'#!/bin/sh\nexec {command} "$@" -O0\n')
    script.chmod(0o755)
    return str(script)


@pytest.fixture(scope="module")
def built(quick, tmp_path_factory):
    """A library of these sources, which `imud warmup` built in place of a truncated one."""
    place = tmp_path_factory.mktemp("built") / "kernels.so"
    place.write_bytes(Path(library.library()._name).read_bytes()[:50_000])
    assert seal.defect(place) == "is damaged"
    ended = run("warmup", IMUD_KERNELS=str(place), CC=quick)
    assert ended.returncode == 0, ended.stderr
    assert "compiling the kernels for these sources" in ended.stderr
    assert str(place) in ended.stdout
    assert [path.name for path in place.parent.iterdir()] == ["kernels.so"]
    return place


@pytest.mark.thorough
def test_what_was_built_is_loaded_and_not_built_again(built):
    assert seal.defect(built) is None
    before = built.read_bytes()
    ended = run("warmup", IMUD_KERNELS=str(built))
    assert (ended.returncode, ended.stderr) == (0, "")
    assert built.read_bytes() == before
    assert set(json.loads(before.rpartition(b"\n")[2])) == {"code", "sources", "files", "levels"}


def test_the_level_is_that_of_the_processor():
    flags = re.search(r"^flags\s*:(.*)", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    has_avx2 = flags is not None and "avx2" in flags[1].split()
    assert levels.of_processor() == ((levels.AVX2, levels.PLAIN) if has_avx2 else (levels.PLAIN,))
    assert levels.of_library(None) == levels.of_processor()[:1]


@pytest.mark.thorough
def test_a_library_for_this_machine_has_the_kernels_of_its_level_only(built):
    symbols = re.findall(rb"\0(imud_[a-z0-9_]+)(?=\0)", built.read_bytes())
    level = levels.of_processor()[0].encode()
    assert len(symbols) > 20
    assert all(symbol.endswith(b"_avx2") == (level == b"_avx2") for symbol in symbols)


@pytest.mark.thorough
def test_without_optimisation_the_bits_are_the_same(built):
    assert digests(LARGER, IMUD_KERNELS=str(built)) == digests(LARGER)


TINY = "#ifndef EXPORTED\n#define EXPORTED(name) name\n#endif\nlong EXPORTED(imud_%s)(void) { return 1; }\n"


@pytest.mark.skipif(os.uname().machine != "x86_64", reason="other machines have one level")
def test_a_wheel_for_others_has_all_kernels_for_each_level_of_processors(quick, tmp_path, monkeypatch):
    assert levels.of_library("aarch64-linux-gnu.2.28") == (levels.PLAIN,)
    every, made = levels.of_library("x86_64-linux-gnu.2.28"), tmp_path / "kernels.so"
    monkeypatch.setattr(levels, "of_library", lambda target: every)
    monkeypatch.setattr(translation, "source", lambda with_lines, is_wanted: TINY % is_wanted("_estimators_ins_"))
    monkeypatch.setattr(sys, "argv", ["imud.compile", str(made)])
    assert translation.main() == 0
    symbols = set(re.findall(rb"\0(imud_[A-Za-z]+(?:_avx2)?)(?=\0)", made.read_bytes()))
    assert symbols == {b"imud_True", b"imud_False", b"imud_True_avx2", b"imud_False_avx2"}
    assert json.loads(made.read_bytes().rpartition(b"\n")[2])["levels"] == list(every)
    assert [path.name for path in tmp_path.iterdir()] == ["kernels.so"]


@contextmanager
def building(folder):
    """A process that builds the library there, once it has written its C."""
    environment = {**os.environ, "IMUD_KERNELS": str(folder / "kernels.so")}
    with subprocess.Popen([sys.executable, "-m", "imud", "warmup"], env=environment, cwd=ROOT) as process:
        deadline = time.monotonic() + 60.0
        while not list(folder.glob("*/*.c")):
            assert time.monotonic() < deadline
            time.sleep(0.02)
        yield process


@pytest.mark.thorough
def test_a_signal_while_building_leaves_nothing_behind(built, tmp_path):
    with building(tmp_path) as process:
        process.send_signal(signal.SIGTERM)
        assert process.wait(30.0) == 143
    assert not list(tmp_path.iterdir())


@pytest.mark.thorough
def test_the_next_build_removes_what_a_killed_one_left_behind(built, tmp_path):
    with building(tmp_path) as process:
        process.kill()
    assert list(tmp_path.glob("kernels-*"))
    (tmp_path / "kernels-of-somebody").touch()  # no folder of a build
    code = """
import shutil, sys
from pathlib import Path
from imud.compile import rebuild
rebuild._in_a_process = lambda output: shutil.copy(sys.argv[2], output)
print(rebuild.rebuild([Path(sys.argv[1])]))
"""
    place = tmp_path / "kernels.so"
    assert run(str(place), str(built), code=code).stdout == f"{place}\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kernels-of-somebody", "kernels.so"]


def test_without_a_compiler_a_message_explains_the_minutes_of_compilation(tmp_path, monkeypatch):
    code = "from imud.compile import library; print(library.library())"
    ended = run(code=code, CC="no-such-compiler", IMUD_KERNELS=str(tmp_path / "kernels.so"))
    assert ended.stdout == "None\n"
    assert "no-such-compiler: No such file or directory" in ended.stderr
    assert "numba compiles" in ended.stderr
    assert not list(tmp_path.iterdir())


def test_a_kernel_that_has_no_translation_ends_the_program_with_its_file_and_line(tmp_path):
    """numba would run it, after minutes in which nobody knows why."""
    (compiler := tmp_path / "python").write_text("#!/bin/sh\necho 'x.py:3: C has no translation' >&2; exit 3\n")
    compiler.chmod(0o755)
    code = """
import sys
import imud.commands
sys.executable = sys.argv[1]
sys.exit(imud.commands.main(["warmup"]))
"""
    ended = run(str(compiler), code=code, IMUD_KERNELS=str(tmp_path / "kernels.so"))
    assert ended.returncode == 64
    assert ended.stderr.splitlines()[-1].startswith("imud: x.py:3: C has no translation; docs/compile.md says")


def test_pip_install_ends_with_a_kernel_that_has_no_translation(tmp_path, monkeypatch):
    """Without a C compiler it goes on: then the first start says why numba compiles."""
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    said = []
    app = SimpleNamespace(display_info=said.append, display_warning=said.append, abort=sys.exit)
    for code in (1, build.UNTRANSLATABLE):
        (compiler := tmp_path / "python").write_text(f"#!/bin/sh\necho 'x.py:3: no translation' >&2; exit {code}\n")
        compiler.chmod(0o755)
        monkeypatch.setattr(sys, "executable", str(compiler))
        made = hook.Hook(str(ROOT), {}, None, None, str(tmp_path), "wheel", app)
        if code == 1:
            assert not made._compile(tmp_path / "kernels.so") and "numba will compile them" in said[-1]
        else:
            with pytest.raises(SystemExit, match=r"x\.py:3: no translation"):
                made._compile(tmp_path / "kernels.so")


def test_the_translation_ends_with_a_code_of_its_own(tmp_path, monkeypatch, capsys):
    def untranslatable(with_lines, is_wanted):
        raise UnsupportedError("x.py:3: C has no translation")

    monkeypatch.setattr(translation, "source", untranslatable)
    monkeypatch.setattr(sys, "argv", ["imud.compile", str(tmp_path / "kernels.so")])
    assert translation.main() == build.UNTRANSLATABLE
    assert capsys.readouterr().err == "x.py:3: C has no translation\n"


@pytest.mark.parametrize(
    ("variables", "says"),
    [
        ({}, "compiled kernels are in "),
        ({"IMUD_JIT": "1"}, "numba compiles the kernels, in minutes: IMUD_JIT is set"),
        (
            {"IMUD_KERNELS": "/absent/kernels.so", "CC": "no-such-compiler"},
            "numba compiles the kernels, in minutes: no-such-compiler: No such file or directory",
        ),
        (
            {"IMUD_KERNELS": "/absent/kernels.so", "CC": "true"},
            "the kernels will be compiled by true at the next start",
        ),
    ],
    ids=["library", "wanted", "no compiler", "not built"],
)
def test_the_version_and_the_doctor_say_what_runs_the_kernels_and_why(variables, says):
    version = run("--version", **variables).stdout.splitlines()
    assert version[0].startswith("imud ") and version[1].startswith(says)
    assert version[1] in run("doctor", **variables).stdout


def test_the_status_says_why_numba_runs():
    code = "from imud.compile import library; print(library.origin())"
    assert run(code=code, IMUD_JIT="1").stdout == "numba: IMUD_JIT is set\n"


@pytest.mark.parametrize("variables", [{"CC": "no-such-compiler"}, {"IMUD_JIT": "1"}])
def test_without_a_library_and_without_numba_a_message_says_what_to_install(variables, tmp_path):
    code = """
import importlib.util, sys
found = importlib.util.find_spec
importlib.util.find_spec = lambda name: None if name == "numba" else found(name)
import imud.commands
sys.exit(imud.commands.main(["warmup"]))
"""
    ended = run(code=code, IMUD_KERNELS=str(tmp_path / "kernels.so"), **variables)
    assert ended.returncode == 64
    assert (
        "numba is not installed: pip install numba; or install gcc" in ended.stderr and "Traceback" not in ended.stderr
    )


def test_numba_on_request():
    ended = run(code="from imud.compile import library; print(library.library())", IMUD_JIT="1")
    assert (ended.stdout, ended.stderr) == ("None\n", "")


def with_locked(folder, lock):
    """Code that has locked that folder of the one in its first argument, and builds empty libraries at once."""
    return f"""
import fcntl, os, signal, sys
from pathlib import Path
from imud.compile import rebuild
signal.alarm(60)  # ends a wait without end
held = os.open(Path(sys.argv[1], "{folder}"), os.O_RDONLY)
fcntl.flock(held, fcntl.LOCK_{lock})
rebuild.LOCK_S = 0.0
rebuild._in_a_process = lambda output: output.touch()
"""


def test_a_program_that_locks_the_folder_for_ever_does_not_stop_the_build(tmp_path):
    for name in ("locked", "free"):
        (tmp_path / name).mkdir()
    code = (
        with_locked("locked", "SH")
        + """
print(rebuild.rebuild([Path(sys.argv[1], name, "kernels.so") for name in ("locked", "free")]))
"""
    )
    assert run(str(tmp_path), code=code).stdout == f"{tmp_path / 'free' / 'kernels.so'}\n"


@pytest.mark.parametrize(("age_s", "used"), [(0.0, "busy"), (1e5, "free")])
def test_a_build_that_takes_long_is_waited_for_and_one_that_was_killed_is_not(age_s, used, tmp_path):
    """Under load a build took four minutes, and each process that waited for a minute began another one, or numba."""
    begun = tmp_path / "busy" / "kernels-begun"
    begun.mkdir(parents=True)
    (tmp_path / "free").mkdir()
    os.utime(begun, (time.time() - age_s,) * 2)
    code = (
        with_locked("busy", "EX")
        + """
looks = iter(range(3))
def sleep(_):
    if next(looks, None) is None:
        os.close(held)
rebuild.time.sleep = sleep
print(rebuild.rebuild([Path(sys.argv[1], name, "kernels.so") for name in ("busy", "free")]))
"""
    )
    assert run(str(tmp_path), code=code).stdout == f"{tmp_path / used / 'kernels.so'}\n"


@pytest.mark.thorough
def test_where_the_package_cannot_be_written_it_is_in_the_cache(built, tmp_path):
    installed = tmp_path / "package"
    installed.mkdir()
    installed.chmod(0o555)
    code = """
import shutil, sys
from pathlib import Path
from imud.compile import library, rebuild
library.INSTALLED = Path(sys.argv[1])
rebuild._in_a_process = lambda output: shutil.copy(sys.argv[2], output)
print(rebuild.rebuild(library.candidates()).parent)
"""
    place = str(installed / "kernels.so")
    ended = run(place, str(built), code=code, before=OBEYING, XDG_CACHE_HOME=str(tmp_path), IMUD_KERNELS="")
    assert ended.stdout.splitlines() == [str(tmp_path / "imud")], ended.stderr


@pytest.mark.thorough
def test_what_a_daemon_calls_is_all_in_the_library(built):
    """So nothing waits for numba, nor loads it."""
    code = """
import sys
from imud import kernel_calls
from imud.configuration.settings import Settings
from imud.estimators import registry
kernel_calls.warm_decoders()
kernel_calls.warm_loop()
for name in registry.NAMES:
    kernel_calls.warm(registry.by_name(name), Settings())
    kernel_calls.warm_replay(registry.by_name(name), Settings())
print("numba" in sys.modules, "llvmlite" in sys.modules)
"""
    ended = run(code=code, IMUD_KERNELS=str(built))
    assert (ended.stdout, ended.stderr) == ("False False\n", "")


def test_a_start_with_a_given_place_does_not_load_numba():
    """Where there is no numba, as on 32-bit ARM, it would be the end."""
    code = """
import sys
sys.modules["numba"] = None
from imud.configuration.settings import Initial, Settings
from imud.estimators import registry
for name in registry.NAMES:
    estimator = registry.by_name(name)
    given = Initial(lat_deg=48.0, lon_deg=11.0, height_m=500.0, yaw_deg=30.0)
    estimator.start(estimator.configure(Settings(), 1000.0), given)
print("started")
"""
    ended = run(code=code)
    assert (ended.stdout, ended.stderr) == ("started\n", "")
