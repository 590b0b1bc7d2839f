"""What the tests of two inertial sensors on one daemon share."""

REST = ("--scenario", "rest", "--roll-deg", "10", "--pitch-deg", "-5", "--patient")
CAR = ("--scenario", "car", "--patient")
RATE_HZ = 250
RATE = ("--set", f"imu.rate_hz={RATE_HZ}")  # of an M-G350; 1000 show nothing more


def level(message, most_deg=1.0):
    return message["class"] == "EST" and "aligning" not in message["state"] and message.get("sroll_deg", 9.0) < most_deg


def plug_in_spare(imud, first, second, port):
    """The sensor on `port` is plugged in as `second` once the one on `first` is in use."""
    imud.says(f"streaming port={first}")
    second.symlink_to(port)
    imud.says(f"a spare, for when {first}, the inertial sensor, is away")
