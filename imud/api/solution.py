"""What the filters of the library return: a row of each array for each sample."""

import importlib
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..estimators.innovation_kinds import KINDS
from ..estimators.records import (
    AT_REST,
    ATTITUDE_VALID,
    HEADING_VALID,
    HEIGHT_VALID,
    POSITION_VALID,
)
from ..math.arrays import Floats, Records
from ..tables.estimates import estimate_cells
from .arguments import FLU, Frames

_ENU = [1, 0, 2]
_UP = np.array([1.0, 1.0, -1.0])
Flags = np.ndarray[Any, np.dtype[np.bool_]]


class Innovations(NamedTuple):
    """Measured minus predicted values. `pandas.DataFrame(innovations._asdict())` makes a table of them."""

    t: Floats  # s
    kind: np.ndarray[Any, np.dtype[np.str_]]  # as in the innovations of `imud replay`, with the unit: pn_m, vn_mps, …
    value: Floats  # NED, whatever the frames
    sigma: Floats  # predicted, 1 sigma
    used: Flags  # False: rejected by its gate


@dataclass(frozen=True)
class Solution:
    """Estimates, one row for each sample (n). Each array is computed when it is asked for.

    Frames: by default position and velocity are north, east, down, the body's axes forward, right, down. With
    `enu-flu` they are east, north, up and forward, left, up, as REP-103 wants them: q then rotates FLU into ENU, and
    yaw counts from east to north. A number that is not known is NaN.

    >>> import numpy as np, imud
    >>> t = np.arange(300) / 100.0
    >>> solution = imud.attitude(t, np.zeros((300, 3)), np.tile([0.0, 0.0, -9.8], (300, 1)))
    >>> solution.roll_deg.shape, bool(solution.attitude_valid[-1]), bool(abs(solution.roll_deg[-1]) < 0.1)
    ((300,), True, True)
    """

    records: Records  # array of `imud.estimators.records.SOLUTION`: NED, FRD, rad
    innovation_records: Records  # array of `imud.estimators.records.INNOVATION`
    origin: int  # s; times in the records count from here
    frames: Frames = "ned-frd"

    def __len__(self) -> int:
        return len(self.records)

    def __repr__(self) -> str:
        n, shares = len(self), ""
        if n:
            valid = {"attitude": self.attitude_valid, "heading": self.heading_valid, "position": self.position_valid}
            shares = "".join(f", {name} valid {100.0 * flags.mean():.0f} %" for name, flags in valid.items())
            shares = f" in {(self.records['t_ns'][-1] - self.records['t_ns'][0]) * 1e-9:.1f} s{shares}"
        return f"<Solution: {n} rows{shares}, {len(self.innovation_records)} innovations, {self.frames}>"

    @property
    def t(self) -> Floats:
        """[n] s, on the time axis of the samples."""
        return self.origin + self.records["t_ns"] * 1e-9

    @property
    def status(self) -> np.ndarray[Any, np.dtype[np.int64]]:
        """[n] bits; docs: `imud reference`."""
        return self.records["status"]

    def _flag(self, bit: int) -> Flags:
        flags: Flags = np.not_equal(self.records["status"] & bit, 0)
        return flags

    @property
    def attitude_valid(self) -> Flags:
        """[n] whether roll and pitch may be trusted to their sigmas."""
        return self._flag(ATTITUDE_VALID)

    @property
    def heading_valid(self) -> Flags:
        """[n] whether yaw may be trusted; otherwise its origin is arbitrary."""
        return self._flag(HEADING_VALID)

    @property
    def position_valid(self) -> Flags:
        """[n] whether latitude, longitude and velocity may be trusted."""
        return self._flag(POSITION_VALID)

    @property
    def height_valid(self) -> Flags:
        """[n] whether the height may be trusted."""
        return self._flag(HEIGHT_VALID)

    @property
    def at_rest(self) -> Flags:
        """[n] whether the sensor is at rest."""
        return self._flag(AT_REST)

    def _world(self, name: str, sign: bool = True) -> Floats:
        v: Floats = self.records[name].copy()
        if self.frames == "ned-frd":
            return v
        return v[:, _ENU] * _UP if sign else v[:, _ENU]

    def _body(self, name: str, sign: bool = True) -> Floats:
        v: Floats = self.records[name].copy()
        return v if self.frames == "ned-frd" or not sign else v * FLU

    @property
    def q(self) -> Floats:
        """[n, 4] unit quaternion (Hamilton, scalar first) that rotates body vectors into the navigation frame."""
        q: Floats = self.records["q_nb"].copy()
        if self.frames == "ned-frd":
            return q
        w, x, y, z = q.T
        turned: Floats = np.stack([w + z, x + y, x - y, w - z], axis=1) * np.sqrt(0.5)
        return turned

    @property
    def _cells(self) -> dict[str, Floats]:
        return estimate_cells(self.records)

    @property
    def roll_deg(self) -> Floats:
        """[n] deg."""
        return self._cells["roll_deg"]

    @property
    def pitch_deg(self) -> Floats:
        """[n] deg; nose up is positive in NED, nose down in ENU."""
        pitch = self._cells["pitch_deg"]
        return pitch if self.frames == "ned-frd" else -pitch

    @property
    def yaw_deg(self) -> Floats:
        """[n] deg, in NED clockwise from north, -180 to 180; in ENU counter-clockwise from east."""
        yaw = self._cells["yaw_deg"]
        return yaw if self.frames == "ned-frd" else 180.0 - np.mod(yaw + 90.0, 360.0)

    @property
    def sigma_rpy_deg(self) -> Floats:
        """[n, 3] 1 sigma of roll, pitch and yaw, deg."""
        sigmas: Floats = np.degrees(self.records["sigma_rpy"])
        return sigmas

    def _positioned(self, values: Floats) -> Floats:
        valid = self.position_valid
        known: Floats = np.where(valid if values.ndim == 1 else valid[:, None], values, np.nan)
        return known

    @property
    def lat_deg(self) -> Floats:
        """[n] geodetic latitude (WGS-84), deg."""
        return self._positioned(np.degrees(self.records["lat"]))

    @property
    def lon_deg(self) -> Floats:
        """[n] longitude, deg."""
        return self._positioned(np.degrees(self.records["lon"]))

    @property
    def height_m(self) -> Floats:
        """[n] m above the ellipsoid; NaN until it is known."""
        return np.where(self.height_valid, self.records["height"], np.nan)

    @property
    def sigma_position_m(self) -> Floats:
        """[n, 3] 1 sigma along the axes of the navigation frame, m."""
        return self._positioned(self._world("sigma_p", sign=False))

    @property
    def velocity_mps(self) -> Floats:
        """[n, 3] m/s in the navigation frame."""
        return self._positioned(self._world("v"))

    @property
    def sigma_velocity_mps(self) -> Floats:
        """[n, 3] 1 sigma, m/s."""
        return self._positioned(self._world("sigma_v", sign=False))

    @property
    def rate_radps(self) -> Floats:
        """[n, 3] angular rate about the body's axes, rad/s, without the estimated biases."""
        return self._body("w")

    @property
    def force_mps2(self) -> Floats:
        """[n, 3] specific force along the body's axes, m/s^2, without the estimated biases."""
        return self._body("f")

    @property
    def gyro_bias_radps(self) -> Floats:
        """[n, 3] rad/s."""
        return self._body("bg")

    @property
    def sigma_gyro_bias_radps(self) -> Floats:
        """[n, 3] 1 sigma, rad/s."""
        return self._body("sigma_bg", sign=False)

    @property
    def accel_bias_mps2(self) -> Floats:
        """[n, 3] m/s^2."""
        return self._body("ba")

    @property
    def sigma_accel_bias_mps2(self) -> Floats:
        """[n, 3] 1 sigma, m/s^2."""
        return self._body("sigma_ba", sign=False)

    @property
    def innovations(self) -> Innovations:
        """Of fixes, aiding measurements, rest and vehicle constraints, in the order in which they were used."""
        rows = self.innovation_records
        return Innovations(
            t=self.origin + rows["t_ns"] * 1e-9,
            kind=np.array([KINDS[int(kind)].column for kind in rows["kind"]], dtype=np.str_),
            value=rows["value"].copy(),
            sigma=np.sqrt(rows["variance"]),
            used=rows["used"] != 0,
        )

    def to_pandas(self) -> Any:
        """A DataFrame: the columns of the table that `imud replay` writes (NED, FRD). Needs pandas."""
        pandas = importlib.import_module("pandas")
        return pandas.DataFrame({"t_s": self.t, **self._cells})
