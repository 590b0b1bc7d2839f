"""One sample further: the same code for new samples and for those integrated again after a late fix."""

from typing import Any

from drivers.sample import LIMITED_FORCE, LIMITED_RATE, NO_FORCE, NO_RATE
from drivers.sample import SATURATED as BEYOND_RANGE

from ...kernels.earth import gravity
from ...kernels.jit import kernel
from ...kernels.kalman import packed_index
from ...kernels.rotation import dcm_of_quat, quat_rotate_back
from ..records import AT_REST, SATURATED
from .alignment import LOST_TILT, disengage, engage, forget_attitude
from .covariance import INTERVAL_S, grow, predict, variance
from .fix_matching import forget_pairs, levelled
from .levelling import level
from .motion import VIBRATION, WINDOW_S, at_rest, clear, gather, judge
from .non_holonomic import INTERVAL_S as CONSTRAINT_S
from .non_holonomic import constrain, learn_axis, stop
from .state import ATTITUDE, LEVELLING, NAVIGATING, POSITION, STATES, VELOCITY
from .strapdown import integrate
from .supervision import VAGUE
from .zero_velocity import rest

CHUNK_S = 0.05
MISSED = 2.5  # sample periods: a longer silence of the sensor hides something
GAP_S = 0.1  # and one longer than that is bridged
GAP_ACCEL, GAP_TURN = 2.0, 0.3  # m/s^2, rad/s: what may happen in a long one, even where the motion was smooth
FITFUL_S = 1.0  # by when a fitful motion has taken another turn
LONGEST_GAP_S = 30.0
HOLD_S = 0.5  # the last rate is held
LOST_S = 1.0  # without rates, then the attitude is found anew: its sigma is beyond what a linear filter can use
AT_THE_END = 0.9  # of the fastest rate: that axis is at the end of its range, too
BEYOND = 0.5  # of a reading at the end of the range, what may be beyond it
SMOOTH_S = 0.2


@kernel
def move(p: Any, c: Any, w: Any, f: Any, dt: float) -> None:
    """Integrate over dt, which is short; while levelling the velocity is what the fixes tell, not an integral."""
    v0, v1, v2 = c.v[0], c.v[1], c.v[2]
    integrate(c, w, f, dt)
    a = min(1.0 / SMOOTH_S, 1.0 / dt)
    c.accel[0] += a * (c.v[0] - v0 - dt * c.accel[0])
    c.accel[1] += a * (c.v[1] - v1 - dt * c.accel[1])
    c.accel[2] += a * (c.v[2] - v2 - dt * c.accel[2])
    if c.phase == LEVELLING:
        c.v[0], c.v[1], c.v[2] = v0, v1, v2
    if c.gathered >= INTERVAL_S:
        predict(p, c)


@kernel
def unseen2(before: Any, after: Any, dt: float, fitful: float, jitter2: float, most: float) -> float:
    """Variance of the mean over a gap of dt s, about that of two readings: of a random walk tied at both ends.

    It has changed as fast as it did at its most fitful, or from one end to the other; the ends vibrate by `jitter2`.
    In a long gap it may have become anything: `most`, or what fitful motion is.
    """
    jump2 = 0.0
    for i in range(3):
        jump2 = max(jump2, (after[i] - before[i]) ** 2)
    return min(max(fitful * dt, jump2) / 12.0, max(fitful * FITFUL_S, most**2)) + 0.5 * jitter2


@kernel
def bridge(p: Any, c: Any, w: Any, f: Any, dt: float) -> None:
    """Integrate over a gap in the samples, holding what is known."""
    chunks = int(dt / CHUNK_S) + 1
    for i in range(3):
        c.w[i] = 0.5 * (c.w[i] + w[i])
        c.f[i] = 0.5 * (c.f[i] + f[i])
    for _ in range(chunks):
        move(p, c, c.w, c.f, dt / chunks)
    predict(p, c)
    c.quiet = 0
    c.still = 0
    clear(c)
    forget_pairs(c)


@kernel
def carry(p: Any, c: Any, t_ns: int, w: Any, f: Any) -> None:
    """Bring the core to time t_ns, at which the sensor shows (w, f)."""
    dt = 1e-9 * (t_ns - c.t_ns)
    if dt <= 0.0:
        return
    dt = min(dt, LONGEST_GAP_S)
    turn2, accel2 = 0.0, 0.0
    if dt > MISSED * p.period:
        turn2 = unseen2(c.w, w, dt, c.fitful[0], c.vibration_gyro / (VIBRATION * p.period), GAP_TURN)
        accel2 = unseen2(c.f, f, dt, c.fitful[1], c.vibration_accel / (VIBRATION * p.period), GAP_ACCEL)
    if dt > max(GAP_S, 5.0 * p.period):
        bridge(p, c, w, f, dt)
    else:
        move(p, c, w, f, dt)
    if turn2 > 0.0:
        for i in range(3):
            grow(c, POSITION + i, 0.25 * accel2 * dt**4)
            grow(c, VELOCITY + i, accel2 * dt**2)
            grow(c, ATTITUDE + i, turn2 * dt**2)
    c.t_ns = t_ns
    for i in range(3):
        c.w[i] = w[i]
        c.f[i] = f[i]


@kernel
def window(p: Any, c: Any) -> None:
    """The end of a motion window: rest, level, and the vehicle's axis."""
    predict(p, c)
    judge(p, c)
    resting = at_rest(c)
    c.flags = c.flags | AT_REST if resting else c.flags & ~AT_REST
    if c.phase == LEVELLING:
        level(c, resting)  # before `rest` turns the attitude that the mean belongs to
    if resting:
        rest(p, c)
    if c.phase == LEVELLING:
        if c.fixes > 0 and c.heading_sigma > 0.0 and levelled(c):
            engage(p, c)
    else:
        learn_axis(p, c)
    clear(c)


@kernel
def fill_in(c: Any, sample: Any) -> None:
    """What the sample does not show: soon no turn, and no acceleration. Nothing of that looks like rest."""
    if sample.flags & NO_RATE and sample.unseen_s > HOLD_S:
        for i in range(3):
            sample.w[i] = c.bg[i]
    if sample.flags & NO_FORCE:
        weight = quat_rotate_back((c.q[0], c.q[1], c.q[2], c.q[3]), (0.0, 0.0, -gravity(c.lat, c.height)))
        for i in range(3):
            sample.f[i] = weight[i] + c.ba[i]
    c.flags &= ~AT_REST
    c.quiet = c.still = 0


@kernel
def doubt_turn(p: Any, c: Any, sample: Any, worst: float, q: float) -> None:
    """Let the attitude's variance grow by q about the axes that show no rate, or the end of their range."""
    m = dcm_of_quat((c.q[0], c.q[1], c.q[2], c.q[3]))
    for axis in range(3):
        if sample.flags & NO_RATE or abs(c.w[axis]) > AT_THE_END * worst:
            for i in range(3):
                for k in range(i, 3):
                    c.P[packed_index(STATES, ATTITUDE + i, ATTITUDE + k)] += q * m[3 * i + axis] * m[3 * k + axis]
    forget_pairs(c)
    if c.phase == NAVIGATING and variance(c, ATTITUDE + 2) > VAGUE**2:
        disengage(p, c)  # neither fixes nor the vehicle's constraint can correct such a heading
        stop(c)
    if max(variance(c, ATTITUDE), variance(c, ATTITUDE + 1)) > LOST_TILT**2:
        forget_attitude(p, c)


@kernel
def doubt(p: Any, c: Any, sample: Any, dt: float) -> None:
    """Let grow what a sample does not show, or only the beginning of, for as long as that lasts."""
    c.flags = c.flags | SATURATED if sample.flags & BEYOND_RANGE else c.flags & ~SATURATED
    if sample.flags == 0:
        c.blind_s[0] = c.blind_s[1] = 0.0
        return
    worst_w = max(abs(c.w[0]), abs(c.w[1]), abs(c.w[2]))
    worst_f = max(abs(c.f[0]), abs(c.f[1]), abs(c.f[2]))
    turn = GAP_TURN if sample.flags & NO_RATE else BEYOND * worst_w if sample.flags & LIMITED_RATE else 0.0
    accel = GAP_ACCEL if sample.flags & NO_FORCE else BEYOND * worst_f if sample.flags & LIMITED_FORCE else 0.0
    for k in range(2):
        before, most = c.blind_s[k], turn if k == 0 else accel
        now = max(before + dt, sample.unseen_s) if most > 0.0 else 0.0
        c.blind_s[k] = now
        if most > 0.0 and k == 0:
            doubt_turn(p, c, sample, worst_w, most**2 * (now**2 - before**2))
        for i in range(3):
            if most > 0.0 and k == 1:
                grow(c, VELOCITY + i, most**2 * (now**2 - before**2))
                grow(c, POSITION + i, 0.25 * most**2 * (now**4 - before**4))


@kernel
def advance(p: Any, c: Any, sample: Any) -> None:
    """Take one kept sample (body axes) and whatever becomes due with it."""
    dt = 1e-9 * (sample.t_ns - c.t_ns)
    c.taken += 1
    if dt <= 0.0:
        return
    blind = sample.flags & (NO_RATE | NO_FORCE) != 0
    if blind:
        fill_in(c, sample)
    gather(c, sample.w, sample.f)
    carry(p, c, sample.t_ns, sample.w, sample.f)
    doubt(p, c, sample, dt)
    if blind:
        clear(c)
    if c.blind_s[0] > LOST_S and sample.flags & NO_RATE:
        forget_attitude(p, c)
    share = min(dt * (1.0 / SMOOTH_S), 1.0)
    for i in range(3):
        c.rate[i] += share * (c.w[i] - c.bg[i] - c.rate[i])
    if c.elapsed >= WINDOW_S and c.n > 3:
        window(p, c)
    c.since_constraint += dt
    seen = c.blind_s[0] == 0.0
    if c.constrained and c.phase == NAVIGATING and seen and c.since_constraint >= CONSTRAINT_S:
        predict(p, c)
        constrain(p, c)
