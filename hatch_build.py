"""Build hook: compiles the kernels, so that a wheel, or an editable install, starts at once (see `imud.compile`).

With IMUD_TARGET in the environment the wheel is for another machine, as zig names it: aarch64-linux-gnu.2.28.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

LIBRARY = "imud/compile/kernels.so"
COMPILERS = ("cc", "gcc", "clang")
_UNTRANSLATABLE = 3  # exit code of imud.compile: an error in the sources, which must not be passed over
_MACHINES = {"arm": "armv7l"}  # of zig to that of a wheel's tag, where they differ
_IMPORTED = ["numpy>=2.0", "msgspec>=0.19", "pyserial>=3.5", "structlog>=24.1"]  # by the kernels' modules


class Hook(BuildHookInterface):  # type: ignore[type-arg]
    """Without a C compiler it asks for the package `ziglang`. If that fails, too, the wheel has no library."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """What `initialize` needs in its environment."""
        native = "IMUD_TARGET" not in os.environ and any(map(shutil.which, COMPILERS))
        return _IMPORTED if native else [*_IMPORTED, "ziglang>=0.13"]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called before the wheel is packed; version: "editable" or "standard"."""
        if self.target_name != "wheel":
            return
        if version == "editable":  # next to the sources, where it is looked for
            self._compile(Path(self.root, LIBRARY))
            return
        self._folder = tempfile.TemporaryDirectory()
        made = Path(self._folder.name, "kernels.so")
        if self._compile(made):
            build_data["force_include"][str(made)] = LIBRARY
            build_data["pure_python"] = False
            build_data["tag"] = f"py3-none-{platform()}"  # any Python: nothing in it depends on one

    def _compile(self, library: Path) -> bool:
        self.app.display_info("imud: compiling the kernels, some 15 s")
        command = [sys.executable, "-m", "imud.compile", str(library)]
        if target := os.environ.get("IMUD_TARGET"):
            command += ["--target", target]
        done = subprocess.run(command, cwd=self.root, capture_output=True, text=True, check=False)
        if done.returncode == _UNTRANSLATABLE:
            self.app.abort(f"imud: {done.stderr}")
        if done.returncode:
            self.app.display_warning(f"imud: the kernels could not be compiled: {done.stderr}")
            self.app.display_warning("imud: numba will compile them at the first start, which takes minutes")
        return done.returncode == 0


def platform() -> str:
    """The tag of the machine that the wheel is for: this one, or the target (PEP 600, PEP 656)."""
    target = os.environ.get("IMUD_TARGET")
    if target is None:
        return sysconfig.get_platform().replace("-", "_").replace(".", "_")
    machine, _, library = target.split("-", 2)
    machine = _MACHINES.get(machine, machine)
    _, _, version = library.partition(".")
    return f"manylinux_{version.replace('.', '_')}_{machine}" if version else f"musllinux_1_2_{machine}"
