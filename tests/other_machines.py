"""Do other processors give the same bits? `python tests/other_machines.py [TARGET..]` says it of each.

The kernels' calls of some golden traces are recorded here, with the contents of their arrays before and after. Then the
same kernels are cross-compiled by `ziglang`, statically with musl, and run under qemu-user on the contents before; what
they make of them is compared. Exit 1 if a word differs or a program cannot be run.
"""

import argparse
import contextlib
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from struct import pack

import numpy as np
from golden import recording
from golden_run import run

from imud.compile.__main__ import source
from imud.compile.build import CannotBuildError, compile_c
from imud.compile.entry import Entry, symbol

HERE = Path(__file__).parent
TARGETS = {  # zig's name -> the emulator of the processor
    "x86_64-linux-musl": "qemu-x86_64-static",
    "aarch64-linux-musl": "qemu-aarch64-static",
    "arm-linux-musleabihf": "qemu-arm-static",
}
RECORDINGS = ("navigation", "attitude", "attitude-hand", "navigation-boat", "riss", "tilt", "suh-adaptive", "gps-track")


def mask(dtype):
    """For each byte of a record: 0 padding, 1 compared, 8 the first of a double, 9 the rest of one."""
    if dtype.subdtype:
        base, shape = dtype.subdtype
        return mask(base) * int(np.prod(shape))
    if dtype.names is None:
        return bytes([8, *[9] * 7]) if dtype.str == "<f8" else bytes([1] * dtype.itemsize)
    made = bytearray(dtype.itemsize)
    for field, at in dtype.fields.values():
        made[at : at + field.itemsize] = mask(field)
    return bytes(made)


@contextlib.contextmanager
def recorded_calls(file, symbols):
    """Within the block every call of a kernel by Python is written to `file`, and its symbol and words to `symbols`."""
    original = Entry.__call__

    def call(entry, *arguments):
        name = symbol(entry, tuple(a.dtype if isinstance(a, np.ndarray) else None for a in arguments))
        arrays = [a for a in arguments if isinstance(a, np.ndarray)]
        before = [a.tobytes() for a in arrays]
        returned = original(entry, *arguments)
        symbols[name] = len(arguments) + len(arrays)
        file.write(pack("<q", len(name)) + name.encode() + pack("<q", len(arguments)))
        contents = iter(before)
        for a in arguments:
            if isinstance(a, np.ndarray):
                file.write(pack("<qq", len(a), a.itemsize) + mask(a.dtype) + next(contents) + a.tobytes())
            else:
                file.write(pack("<qq", -1, a))
        file.write(pack("<q", returned))
        return returned

    Entry.__call__ = call
    try:
        yield
    finally:
        Entry.__call__ = original
        file.write(pack("<q", 0))


def calls_source(symbols):
    """The table of the kernels that were called, in C."""
    rows = [f'{{"{name}", call_{k}}}' for k, name in enumerate(symbols)]
    stubs = [
        f"static int64_t call_{k}(const int64_t *w) {{ return {name}({', '.join(f'w[{i}]' for i in range(words))}); }}"
        for k, (name, words) in enumerate(symbols.items())
    ]
    table = "static const struct { const char *name; int64_t (*call)(const int64_t *); } calls[] = {"
    return "\n".join([*stubs, table + ", ".join(rows) + "};\n"])


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("targets", nargs="*", default=list(TARGETS), help=f"of {', '.join(TARGETS)} (default: all)")
    targets = parser.parse_args().targets
    failed = False
    with tempfile.TemporaryDirectory() as name:
        folder, symbols = Path(name), {}
        with (folder / "calls").open("wb") as file, recorded_calls(file, symbols):
            for each in RECORDINGS:
                run(recording(each))
        (folder / "kernels.c").write_text(source(with_lines=False))
        (folder / "calls.c").write_text(calls_source(symbols))
        shutil.copy(HERE / "c" / "same_bits.c", folder)
        for target in targets:
            program = folder / target
            try:
                compile_c(folder / "same_bits.c", program, ("-static",), target, shared=False)
                done = subprocess.run(
                    [TARGETS[target], program, folder / "calls"], capture_output=True, text=True, check=False
                )
                print(f"{target}: {done.stdout}{done.stderr}", end="", flush=True)
                failed |= done.returncode != 0
            except (CannotBuildError, OSError, KeyError) as error:
                print(f"{target}: {error}", flush=True)
                failed = True
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
