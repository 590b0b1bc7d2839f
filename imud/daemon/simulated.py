"""`sim:SCENARIO` ports: emulated devices as processes of their own, which the daemon opens as if they were hardware.

Ports of the same scenario share one emulator, so that they measure the same motion from the same instant. It ends with
the block, and also when this process dies.
"""

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from imud.drivers.errors import SpecError
from imud.drivers.registry import names
from imud.drivers.transport.portspec import PortSpec

from ..errors import ImudError, UsageError

SCHEME = "sim:"
DEVICES = {
    None: "g350",
    "epson": "g350",
    "crossbow": "rga300",
    "seraccel": "seraccel",
    "nmea": "nmea",
    "ubx": "ubx",
}  # by driver
OTHERS = ("wheel", "baro", "compass")  # devices that the user names themselves instead of a driver; all speak NMEA
_USAGE_ERROR = 64  # exit code of the emulator


@contextlib.contextmanager
def ports(texts: Sequence[str], seed: int) -> Iterator[tuple[str, ...]]:
    """`texts` with those of emulated devices replaced by the pseudo-terminals on which they are now.

    seed: of the sensors' errors. Raises UsageError for a scenario or a speed that the emulator does not know.
    """
    specs = [_spec(text) for text in texts]
    scenarios = dict.fromkeys(spec.path for spec in specs if spec.path.startswith(SCHEME))
    if not scenarios:
        yield tuple(map(str, specs))
        return
    import tempfile  # for emulated devices only

    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="imud-sim-")))
        for scenario in scenarios:
            own = [i for i, spec in enumerate(specs) if spec.path == scenario]
            wanted = [specs[i] for i in own]
            for i in own:
                path = folder / f"{scenario[len(SCHEME) :]}-{_device(specs[i])}-{i}"
                driver = "nmea" if specs[i].driver in OTHERS else specs[i].driver
                specs[i] = replace(specs[i], path=str(path), driver=driver)
            stack.enter_context(_emulator(wanted, [specs[i].path for i in own], seed, folder / "log"))
        yield tuple(map(str, specs))


def _spec(text: str) -> PortSpec:
    try:
        return PortSpec.parse(text, (*names(), *OTHERS) if text.startswith(SCHEME) else None)
    except SpecError as error:
        raise UsageError(str(error)) from error


def _device(spec: PortSpec) -> str:
    """What the emulator calls the device of a driver."""
    return str(spec.driver) if spec.driver in OTHERS else DEVICES[spec.driver]


@contextlib.contextmanager
def _emulator(specs: Sequence[PortSpec], links: Sequence[str], seed: int, log: Path) -> Iterator[None]:
    """A process with a device for each of `specs`, all of one scenario, at `links`."""
    import subprocess

    scenario = specs[0].path[len(SCHEME) :]
    command = [sys.executable, "-m", "imud.firmware_sim", f"--scenario={scenario}", f"--seed={seed}"]
    command += [f"--parent={os.getpid()}", *(f"--link={link}" for link in links), "--"]
    command += [_device(spec) + (f"@{spec.baud}" if spec.baud else "") for spec in specs]
    with log.open("w") as errors:
        # a session of its own, so that Ctrl-C reaches this process only, which then ends the emulator
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=errors, stdin=subprocess.DEVNULL, start_new_session=True
        )
    with process:
        try:
            assert process.stdout is not None
            if not all(process.stdout.readline() for _ in specs):
                kind = UsageError if process.wait() == _USAGE_ERROR else ImudError
                why = log.read_text().strip().rpartition("\n")[2].rpartition("error: ")[2]
                raise kind(f"port {specs[0].path!r}: {why}")
            yield
        finally:
            process.terminate()
