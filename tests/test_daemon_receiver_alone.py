"""What the daemon says of a receiver without an inertial sensor: the same, whatever the other port lacks."""

import pytest
from processes import daemon, emulator

SAYS = "no inertial sensor streams: only the receiver's fixes are passed on"


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("other", "settings", "why"),
    [
        ((), (), "trying again"),
        (("nmea",), (), "a spare, for when"),
        (("g350",), ("--set", "readonly=true"), "trying again"),
    ],
    ids=["absent", "another receiver", "silent and readonly"],
)
def test_a_receiver_alone(tmp_path, other, settings, why):
    links = [tmp_path / "gnss", tmp_path / "imu"]
    ports = [word for link in links for word in ("--port", str(link))]
    emulated = emulator("nmea", *other, "--no-fix", "0", links=links[: 1 + len(other)])
    with emulated, daemon(tmp_path, *ports, *settings) as imud:
        imud.says(SAYS)
        assert why in imud.log
        imud.until(lambda m: m["class"] == "TPV" and m["mode"] == 3)
        assert imud.log.count(SAYS) == 1
