"""`replay:FILE` among a daemon's ports: alone it stands for every device in the recording."""

from collections.abc import Sequence
from importlib import util
from pathlib import Path

from ..errors import BadDataError, InputMissingError, UsageError
from ..setup.choices import RECORDED


def expanded(texts: Sequence[str]) -> tuple[str, ...]:
    """`texts`, or a port for each device of the recording that the only one of them names as a whole.

    Raises UsageError, InputMissingError, BadDataError.
    """
    if len(texts) != 1 or not texts[0].startswith(RECORDED):
        return tuple(texts)
    if texts[0] == RECORDED:
        raise UsageError(f"port {RECORDED!r}: name the recording, for example {RECORDED}drive.mcap")
    path = Path(texts[0][len(RECORDED) :])
    if not path.exists() and path.name.rpartition(":")[1]:
        return tuple(texts)  # names one of its devices
    if util.find_spec("mcap") is None:
        raise UsageError("recordings need the package mcap: pip install 'imud[record]'")
    from imud.drivers.capture import Capture
    from imud.drivers.errors import CaptureError

    try:
        devices = Capture(path).devices()
    except CaptureError as error:
        raise BadDataError(str(error)) from error
    except OSError as error:
        raise InputMissingError(f"{path} cannot be read: {error.strerror}") from error
    if not devices:
        raise BadDataError(f"{path}: no device streamed when this was recorded")
    return tuple(f"{texts[0]}:{device.driver}" for device in devices)
