"""Build hook: compiles the kernels, so that a wheel, or an editable install, starts at once (see `imud.compile`)."""

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
_IMPORTED = ["numpy>=2.0", "msgspec>=0.19", "pyserial>=3.5", "structlog>=24.1"]  # by the kernels' modules


class Hook(BuildHookInterface):  # type: ignore[type-arg]
    """Without a C compiler it asks for the package `ziglang`. If that fails, too, the wheel has no library."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """What `initialize` needs in its environment."""
        return _IMPORTED if any(map(shutil.which, COMPILERS)) else [*_IMPORTED, "ziglang>=0.13"]

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
            platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
            build_data["tag"] = f"py3-none-{platform}"  # any Python: nothing in it depends on one

    def _compile(self, library: Path) -> bool:
        self.app.display_info("imud: compiling the kernels, some 15 s")
        command = [sys.executable, "-m", "imud.compile", str(library)]
        done = subprocess.run(command, cwd=self.root, capture_output=True, text=True, check=False)
        if done.returncode:
            self.app.display_warning(f"imud: the kernels could not be compiled: {done.stderr}")
            self.app.display_warning("imud: numba will compile them at the first start, which takes minutes")
        return done.returncode == 0
