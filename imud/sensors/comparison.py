"""Whether two inertial sensors on one body sense the same motion, and if not, which of them is wrong.

The rates of a rigid body are the same everywhere on it; specific forces differ by the lever arm between the sensors.
So the means over a second differ by biases, and in proportion to themselves by scale factors and by mountings that are
not quite those of the settings. Both are learned, axis by axis, from the switch-on sigmas on: a Kalman filter whose
state is a bias and three slopes. A difference that this does not explain for `LASTING` seconds is a disagreement.

A rotation between the two is learned beside it (`RelativeRotation`): where one explains what disagrees, a sensor sits
otherwise than its mounting in the settings says. While they agree, it is what the comparison cannot exclude.

Which sensor is wrong is decided on evidence only: its own monitor finds a fault; or gravity contradicts one of the two
and agrees with the other, since at rest its magnitude is known, and without acceleration the measured gravity rotates
at the body's rate; or a third sensor agrees with one of them. What is frozen or at the end of its range cannot be
compared: if nearly all samples of a sensor are so for some windows, and those of another one are not, it is wrong.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imud.drivers.sample import NO_FORCE, NO_RATE, SAMPLE, SATURATED, SUSPECT

from ..math.arrays import Floats, Records
from ..math.earth import STANDARD_GRAVITY
from ..math.rotation import UNKNOWN_ANGLE
from ..sensor_errors.profiles import Profile
from .relative_rotation import RelativeRotation, Rotation, better_known

WINDOW_NS, WINDOW_S = 1_000_000_000, 1.0
WHOLE = 0.8  # of a window that samples must span
SIGMAS = 4.0  # beyond which an axis differs
CONTRADICTED = 4.0  # sigmas: one sensor is further from gravity than the other by more, which itself is not
LASTING = 3  # windows
LEVER_ARM_M = 1.0  # between the sensors, at most
DELAY_S = 0.02  # of one sensor's samples against the other's
MOUNTING = math.radians(3.0)  # error of a mounting
UNSTEADY = 0.1  # of the switch-on bias: what temperature and vibration may change within minutes
GRAVITY_SPREAD = 0.03  # m/s^2: equator and poles
_AXES = {"rates": slice(0, 3), "forces": slice(3, 6)}
_UNFIT = SATURATED | NO_RATE | NO_FORCE
_UNUSABLE = "it is frozen or at the end of its range, and another one is not"


class Means(NamedTuple):
    """Of one window; rates x y z in rad/s, forces x y z in m/s^2, body axes."""

    mean: Floats
    spread: Floats  # standard deviations
    swept: float  # m/s^2 of force for each metre of lever arm; infinite without gyros


@dataclass
class Sensor:
    """A sensor that streams: its errors as its profile has them, and what it sensed in the last windows.

    mounting_sigma: rad, about each axis, of its mounting against the others, as far as it is known without comparing.
    """

    profile: Profile
    has_gyros: bool
    mounting_sigma: float
    means: dict[int, Means] = field(default_factory=dict)  # by number of the window
    unfit: int = 0  # windows in sequence, of which nearly all samples are frozen or at the end of the range
    _number: int = -1
    _blocks: list[bytes] = field(default_factory=list)  # samples of this window

    def add(self, samples: Records) -> None:
        """Samples (SAMPLE) in body axes, in order."""
        times = samples["t_ns"]
        if len(times) and times.item(0) // WINDOW_NS == self._number == times.item(-1) // WINDOW_NS:  # nearly always
            self._blocks.append(samples.tobytes())  # copied much faster than fields are
            return
        sound = samples[samples["flags"] & SUSPECT == 0]
        numbers = sound["t_ns"] // WINDOW_NS
        for number in sorted(set(numbers.tolist())):
            if number != self._number:
                self._finish()
                self._number = number
            self._blocks.append(sound[numbers == number].tobytes())

    def _finish(self) -> None:
        rows = np.frombuffer(b"".join(self._blocks), SAMPLE)
        rows = rows[rows["flags"] & SUSPECT == 0]
        if len(rows) and int(rows["t_ns"][-1] - rows["t_ns"][0]) > WHOLE * WINDOW_NS:
            readings = np.hstack([rows["w"], rows["f"]])
            if not self.has_gyros:
                readings[:, :3] = 0.0
            unfit = rows["flags"] & _UNFIT != 0
            self.unfit = self.unfit + 1 if unfit.mean() > WHOLE else 0
            readings[unfit] = np.nan
            if np.isfinite(readings).all():
                mean, spread = readings.mean(axis=0), readings.std(axis=0)
                self.means[self._number] = Means(mean, spread, self._swept(readings[:, :3]))
        for old in [number for number in self.means if number < self._number - 2 * LASTING]:
            del self.means[old]
        self._blocks.clear()

    def _swept(self, rates: Floats) -> float:
        if not self.has_gyros:
            return math.inf
        tenth = max(1, len(rates) // 10)
        turned = rates[-tenth:].mean(axis=0) - rates[:tenth].mean(axis=0)
        return float((rates**2).sum(axis=1).mean() + np.linalg.norm(turned) / WINDOW_S)

    def contradicted_by_gravity(self, number: int) -> dict[str, tuple[float, float]]:
        """By how much this window contradicts gravity, if the body is not accelerated, and the sigma of that."""
        now, before, p = self.means[number], self.means.get(number - 1), self.profile
        force = float(np.linalg.norm(now.mean[3:]))
        moved = float(np.linalg.norm(now.spread[3:]))  # what moves may be accelerated
        sigma = math.hypot(p.accel_bias_initial, p.accel_scale * STANDARD_GRAVITY, GRAVITY_SPREAD, moved)
        found = {"forces": (abs(force - STANDARD_GRAVITY), sigma)}
        if before is not None and self.has_gyros:
            middle = 0.5 * (now.mean + before.mean)
            drift = (now.mean[3:] - before.mean[3:]) / WINDOW_S + np.cross(middle[:3], middle[3:])
            rate = p.gyro_scale * float(np.linalg.norm(middle[:3]))
            sigma = math.hypot(p.gyro_bias_initial, rate, (p.accel_noise + moved) / STANDARD_GRAVITY)
            found["rates"] = float(np.linalg.norm(drift)) / STANDARD_GRAVITY, sigma
        return found


class Pair:
    """Two sensors by name, and the learned difference between them. groups: what both have, of rates and forces."""

    def __init__(self, sensors: dict[str, Sensor], groups: tuple[str, ...]) -> None:
        self.sensors, self.blamed = sensors, ""  # the sensor that evidence speaks against; empty: there is none
        self._compared, self.windows = -1, 0  # number of the last window; how many were compared
        self._lasted = dict.fromkeys(groups, 0)  # windows that disagreed, less those that agreed
        self._evidence = dict.fromkeys(groups, ("", 0))  # against which sensor, in how many windows in sequence
        profiles = [each.profile for each in sensors.values()]

        def both(gyro: str, accel: str) -> Floats:
            return np.repeat([sum(getattr(p, name) ** 2 for p in profiles) for name in (gyro, accel)], 3)

        self._bias2 = both("gyro_bias_initial", "accel_bias_initial")
        self._noise2 = both("gyro_noise", "accel_noise") / WINDOW_S
        self._walk2 = both("gyro_bias_instability", "accel_bias_instability") * WINDOW_S
        slope2 = both("gyro_scale", "accel_scale") + MOUNTING**2
        self._state = np.zeros((6, 4))
        self._cov = np.array([np.diag((bias2, s2, s2, s2)) for bias2, s2 in zip(self._bias2, slope2, strict=True)])
        biases2 = tuple(float(self._bias2[_AXES[group]].max()) for group in groups)
        scale2 = sum(max(p.accel_scale, p.gyro_scale) ** 2 for p in profiles)
        self._rotation = RelativeRotation(biases2, scale2)
        self._mounting_sigma = math.hypot(*(each.mounting_sigma for each in sensors.values()))
        self.possible: Rotation | None = None  # of the second sensor to the first, which they have not contradicted

    def compare(self) -> None:
        """Compare the means over those windows that both sensors have completed."""
        one, other = self.sensors.values()
        for number in sorted(one.means.keys() & other.means.keys()):
            if number > self._compared:
                self._compared = number
                self.windows += 1
                self._compare(number)

    def _compare(self, number: int) -> None:
        a, b = (each.means[number] for each in self.sensors.values())
        spread = np.minimum(a.spread, b.spread)  # a spread that only one sensor has is not motion
        swept = min(a.swept, b.swept)
        variance = self._noise2 + UNSTEADY**2 * self._bias2 + 12.0 * (DELAY_S / WINDOW_S * spread) ** 2
        variance[3:] += (LEVER_ARM_M * swept) ** 2 if math.isfinite(swept) else 0.0
        axes = [_AXES[group] for group in self._lasted]
        self._rotation.add([(a.mean[axis], b.mean[axis], float(variance[axis].max())) for axis in axes])
        rows = np.ones((6, 4))  # what bias and slopes of each axis are multiplied by
        rows[:3, 1:], rows[3:, 1:] = a.mean[:3], a.mean[3:]
        self._cov[:, 0, 0] += self._walk2
        cross = (self._cov @ rows[:, :, None])[:, :, 0]
        total = (rows * cross).sum(axis=1) + variance
        innovation = b.mean - a.mean - (rows * self._state).sum(axis=1)
        differs = innovation**2 > SIGMAS**2 * total
        gain = np.where(differs, 0.0, 1.0 / total)[:, None]
        self._state += cross * innovation[:, None] * gain
        self._cov -= cross[:, :, None] * cross[:, None, :] * gain[:, :, None]
        if not any(differs[axis].any() for axis in axes) and (now := self._rotation.solve(self._mounting_sigma)):
            self.possible = better_known(self.possible, now)
        found = [each.contradicted_by_gravity(number) for each in self.sensors.values()]
        for group in self._lasted:
            windows = self._lasted[group] + (1 if differs[_AXES[group]].any() else -1)
            self._lasted[group] = min(max(windows, 0), 2 * LASTING)
            wrong = self._contradicted([each[group] for each in found if group in each])
            before, windows = self._evidence[group]
            self._evidence[group] = (wrong, windows + 1 if wrong and wrong == before else 1)

    def _contradicted(self, found: list[tuple[float, float]]) -> str:
        """The one of the two that gravity contradicts while the other fits; empty: it does not show it."""
        if len(found) < 2:
            return ""
        (least, sigma), (excess, other_sigma) = sorted(found)
        if least > CONTRADICTED * sigma or excess - least < CONTRADICTED * math.hypot(sigma, other_sigma):
            return ""
        return list(self.sensors)[found.index((excess, other_sigma))]

    def judge(self, faulty: set[str]) -> None:
        """After `compare`: find which sensor is wrong. faulty: sensors whose own monitors find faults."""
        if not self.differing:
            self.blamed = ""
            return
        found = faulty.intersection(self.sensors)
        found |= {self._evidence[group][0] for group in self.differing if self._evidence[group][1] >= LASTING}
        if len(found - {""}) == 1:
            self.blamed = (found - {""}).pop()

    @property
    def differing(self) -> list[str]:
        """The groups that have disagreed for long enough."""
        return [group for group, windows in self._lasted.items() if windows >= LASTING]

    def rotation(self) -> Rotation | None:
        """From the second sensor's axes to the first one's, where that explains what disagrees and is known."""
        found = self._rotation.solve() if self.differing else None
        return found if found is not None and found.sigma < MOUNTING < 0.5 * found.angle else None


class Verdict(NamedTuple):
    """What is said of a sensor: in words, whether it is known that it is the one that is wrong, and of what."""

    text: str
    is_wrong: bool
    groups: tuple[str, ...]


class SensorComparison:
    """All sensors of one body that stream, by name. Not thread-safe."""

    def __init__(self) -> None:
        self._sensors: dict[str, Sensor] = {}
        self._pairs: list[Pair] = []
        self.verdicts: dict[str, Verdict] = {}  # by name, of those that disagree

    def join(self, name: str, profile: Profile, has_gyros: bool, mounting_sigma: float = UNKNOWN_ANGLE) -> None:
        """A sensor begins to stream. mounting_sigma: see `Sensor`."""
        self.leave(name)
        sensor = Sensor(profile, has_gyros, mounting_sigma)
        for earlier, known in self._sensors.items():
            groups = ("rates", "forces") if has_gyros and known.has_gyros else ("forces",)
            self._pairs.append(Pair({earlier: known, name: sensor}, groups))
        self._sensors[name] = sensor

    def leave(self, name: str) -> None:
        """A sensor streams no more."""
        self._sensors.pop(name, None)
        self._pairs = [pair for pair in self._pairs if name not in pair.sensors]
        self._judge(set())

    def add_samples(self, name: str, samples: Records) -> None:
        """Samples (SAMPLE) of that sensor, in body axes."""
        self._sensors[name].add(samples)

    def update(self, faulty: set[str]) -> None:
        """Call several times a second: compares what is complete. faulty: whose own monitors find faults."""
        for pair in self._pairs:
            pair.compare()
        self._judge(faulty)

    def _judge(self, faulty: set[str]) -> None:
        for pair in self._pairs:
            pair.judge(faulty)
        wrong = {name for name in self._sensors if self._is_outvoted(name)} | {pair.blamed for pair in self._pairs}
        self.verdicts = {}
        for name in self._sensors:
            open_ = [p for p in self._of(name) if p.differing and (name in wrong or not wrong.intersection(p.sensors))]
            if open_:
                others = ", ".join(sorted({other for pair in open_ for other in pair.sensors} - {name}))
                groups = tuple(sorted({group for pair in open_ for group in pair.differing}))
                end = "it is the one that is wrong" if name in wrong else "one of them is wrong; or see imu.mounts"
                text = f"{' and '.join(groups)} disagree with those of {others}: {end}"
                self.verdicts[name] = Verdict(text, name in wrong, groups)
        if any(sensor.means and not sensor.unfit for sensor in self._sensors.values()):
            for name in [name for name, sensor in self._sensors.items() if sensor.unfit >= LASTING]:
                self.verdicts[name] = Verdict(_UNUSABLE, True, ())

    def agree(self, name: str, other: str) -> bool:
        """Whether these two have been compared for long enough and sense the same."""
        pairs = [pair for pair in self._of(name) if other in pair.sensors]
        return any(not pair.differing and pair.windows > 3 * LASTING for pair in pairs)

    def rotation(self, name: str, other: str) -> Rotation | None:
        """From the axes of `name` to those of `other`, where that explains why the two disagree and is known."""
        return self._between(name, other, Pair.rotation)

    def possible_rotation(self, name: str, other: str) -> Rotation | None:
        """The same while they agree: what the comparison has not excluded; None: they have hardly been compared."""
        return self._between(name, other, lambda pair: pair.possible)

    def _between(self, name: str, other: str, rotation: Callable[[Pair], Rotation | None]) -> Rotation | None:
        for pair in self._of(name):
            if other in pair.sensors and (found := rotation(pair)) is not None:
                return found if list(pair.sensors)[1] == name else found.inverse
        return None

    def _of(self, name: str) -> list[Pair]:
        return [pair for pair in self._pairs if name in pair.sensors]

    def _is_outvoted(self, name: str) -> bool:
        """Whether this sensor disagrees with all of several others, of which some agree with one another."""
        others = [pair for pair in self._pairs if name not in pair.sensors]
        return all(pair.differing for pair in self._of(name)) and any(not pair.differing for pair in others)
