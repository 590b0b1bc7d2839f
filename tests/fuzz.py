"""Fuzzing of what imud reads from outside: `python tests/fuzz.py SURFACE --minutes N [--seed N]`.

A surface is a function that takes any bytes and must not raise (see `fuzz_surfaces.py`). Inputs are made by changing
those of the corpus (`tests/corpus/SURFACE/`, and examples in the code), at random; with --guided, by the package
atheris, which keeps the changes that reach new lines and changes them further. What fails is written to
`tests/corpus/SURFACE/` under the digest of its bytes, where `test_fuzz.py` tries it in every run from then on.
"""

import argparse
import hashlib
import importlib.util
import random
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
sys.path.insert(0, str(Path(__file__).parent))

from fuzz_surfaces import SURFACES, Surface  # noqa: E402

CORPUS = Path(__file__).parent / "corpus"
_LONGEST = 1 << 14


def inputs_of(name: str) -> list[bytes]:
    """The corpus of a surface: examples, and inputs that once failed."""
    return [*SURFACES[name].examples, *(path.read_bytes() for path in sorted((CORPUS / name).glob("*")))]


def changed(data: bytes, others: list[bytes], words: tuple[bytes, ...], chance: random.Random) -> bytes:
    """The input after a few random changes."""
    changes: tuple[Callable[[bytes, int, int], bytes], ...] = (
        lambda d, a, b: d[:a] + d[b:],
        lambda d, a, b: d[:b] + d[a:b] + d[b:],
        lambda d, a, b: d[:a] + chance.randbytes(chance.randint(1, 4)) + d[b:],
        lambda d, a, b: d[:a] + bytes([chance.randrange(256)]) + d[a + 1 :],
        lambda d, a, b: d[:a] + bytes([d[a] ^ 1 << chance.randrange(8)]) + d[a + 1 :] if a < len(d) else d,
        lambda d, a, b: d[:a] + chance.choice(words) + d[a:],
        lambda d, a, b: d[:a] + chance.choice(words) + d[b:],
        lambda d, a, b: d[:a] + chance.choice(others)[-(b - a) :] + d[b:],
        lambda d, a, b: d[:a] + str(chance.choice((0, -1, 2**63, 10**400, 1e-300, 1e300))).encode() + d[b:],
    )
    for _ in range(chance.choice((1, 1, 2, 3, 8))):
        begin, end = sorted((chance.randint(0, len(data)), chance.randint(0, len(data))))
        if end - begin > 8 and chance.random() < 0.8:
            end = begin + chance.randint(0, 8)
        data = chance.choice(changes)(data, begin, end)[:_LONGEST]
    return data


def failure(surface: Surface, data: bytes) -> str:
    """The traceback of what the surface raises; empty: nothing."""
    try:
        surface.take(data)
    except Exception:
        return traceback.format_exc()
    return ""


def keep(name: str, data: bytes, trace: str) -> None:
    """Write an input that fails into the corpus."""
    path = CORPUS / name / hashlib.sha256(data).hexdigest()[:16]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    print(f"{trace}\n{name}: {len(data)} bytes in {path} fail", file=sys.stderr)


def blind(name: str, seconds: float, seed: int) -> tuple[int, int]:
    """Change inputs at random until the time is up; returns how many were tried, and how many kinds of failure."""
    chance, surface, inputs = random.Random(seed), SURFACES[name], inputs_of(name)
    end_s, tried, kinds = time.monotonic() + seconds, 0, set[str]()
    while time.monotonic() < end_s:
        data = changed(chance.choice(inputs), inputs, surface.words, chance)
        tried += 1
        if trace := failure(surface, data):
            kind = "\n".join(trace.splitlines()[-3:-1])
            if kind not in kinds:
                kinds.add(kind)
                keep(name, data, trace)
    return tried, len(kinds)


def kernel_modules() -> list[str]:
    """Names of the modules that numba compiles, which cannot be instrumented: it would not know the instructions."""
    paths = (path for folder in ("imud", "drivers") for path in (ROOT / folder).rglob("*.py"))
    parts = (path.relative_to(ROOT).with_suffix("").parts for path in paths if "@kernel" in path.read_text())
    return [".".join(each if each[0] == "imud" else ("imud", *each)) for each in parts]


def guided(name: str, seconds: float) -> None:
    """Let atheris look for inputs that reach new lines, beginning with the corpus; it ends the process."""
    import atheris

    inputs = inputs_of(name)
    ours = {path.stem for path in Path(__file__).parent.glob("*.py")} - {"fuzz"} | {"imud"}
    for module in list(sys.modules):
        if module.split(".")[0] in ours:
            del sys.modules[module]
    with atheris.instrument_imports(include=["imud"], exclude=kernel_modules()):
        import fuzz_surfaces as instrumented

        for data in inputs:  # some modules are imported only now
            instrumented.SURFACES[name].take(data)
    folder = Path(tempfile.mkdtemp(prefix=f"imud-fuzz-{name}-"))  # grows by what reaches new lines
    for number, data in enumerate(inputs):
        (folder / str(number)).write_bytes(data)
    failed = CORPUS / name
    failed.mkdir(parents=True, exist_ok=True)
    options = [f"-max_total_time={round(seconds)}", f"-artifact_prefix={failed}/", f"-max_len={_LONGEST}"]
    atheris.Setup([sys.argv[0], *options, str(folder)], instrumented.SURFACES[name].take)
    atheris.Fuzz()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0], allow_abbrev=False)
    parser.add_argument("surface", choices=[*SURFACES, "all"])
    parser.add_argument("--minutes", type=float, default=1.0, help="for each surface (default 1)")
    parser.add_argument("--guided", action="store_true", help="by coverage, with the package atheris; one surface")
    parser.add_argument("--seed", type=int, default=time.time_ns(), help="of the random changes")
    args = parser.parse_args()
    if args.guided and (args.surface == "all" or importlib.util.find_spec("atheris") is None):
        parser.error("--guided needs the package atheris, and one surface")
    if args.guided:
        guided(args.surface, 60.0 * args.minutes)
    failed = 0
    for name in SURFACES if args.surface == "all" else [args.surface]:
        tried, kinds = blind(name, 60.0 * args.minutes, args.seed)
        print(f"{name:<12} {tried:>9} inputs, {kinds} kinds of failure (seed {args.seed})", flush=True)
        failed += kinds
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
