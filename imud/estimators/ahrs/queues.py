"""Where in a queue samples were lost: the readings show between which two more than a period has passed.

That a queue lacks samples its newest stamp shows, once the next queue begins; which ones it lacks is not stamped. But
where motion is smooth, the rate changes as much from each sample to the next, and twice as much where one is lost
between them. So each interval of the queue has a likelihood ratio for a lost sample, from how well the mean of its
neighbours' changes, or twice that mean, explains its own; how well it usually does is learned. What is lost has turned
the body by the mean of the rates in these intervals, in NED, each with its probability; their scatter is its variance.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...compile.jit import kernel
from ...math.rotation import Vector, dot, quat_rotate, quat_rotate_back
from .integrals import add_noise
from .last_sample import set_gap
from .stamps import LOSS_PROBABILITY, NOISE_SIGMAS

if TYPE_CHECKING:
    from .types import Parameters, State

ROUGH = 1.0  # most of a change, over its neighbours', squared, that counts as one that they do not explain


@kernel
def follow_queue(p: Parameters, s: State, w: Vector, f: Vector) -> None:
    """A sample, rate w and force f, has been integrated; s.imu is the one before."""
    if s.stamps.waiting == 0:
        s.queue.intervals = 0
        return
    if s.stamps.late == 1:
        s.queue.weight = s.queue.square = 0.0
        for i in range(3):
            s.queue.rate[i] = s.queue.force[i] = 0.0
    else:
        weigh_newest_interval(p, s, w)
    store_interval(s, w, f)


@kernel
def store_interval(s: State, w: Vector, f: Vector) -> None:
    """That from the newest sample to this one becomes the newest interval."""
    queue, last, q = s.queue, s.imu, (s.nav.q_nb[0], s.nav.q_nb[1], s.nav.q_nb[2], s.nav.q_nb[3])
    rate = quat_rotate(q, (0.5 * (last.w[0] + w[0]), 0.5 * (last.w[1] + w[1]), 0.5 * (last.w[2] + w[2])))
    force = quat_rotate(q, (0.5 * (last.f[0] + f[0]), 0.5 * (last.f[1] + f[1]), 0.5 * (last.f[2] + f[2])))
    for i in range(3):
        queue.change_before[i] = queue.change[i]
        queue.change[i] = w[i] - last.w[i]
        queue.newest_rate[i], queue.newest_force[i] = rate[i], force[i]
    queue.intervals += 1


@kernel
def weigh_newest_interval(p: Parameters, s: State, w: Vector) -> None:
    """Add the newest interval to the sums, now that rate w shows the change after it."""
    queue = s.queue
    if queue.intervals < 2:
        add_newest_interval(s, 1.0)
        return
    once2 = twice2 = near2 = 0.0
    for i in range(3):
        after = w[i] - s.imu.w[i]
        expected = 0.5 * (queue.change_before[i] + after)
        once2 += (queue.change[i] - expected) ** 2
        twice2 += (queue.change[i] - 2.0 * expected) ** 2
        near2 += 0.5 * (queue.change_before[i] ** 2 + after * after)
    noise2 = NOISE_SIGMAS**2 * 2.0 * p.gyro_psd / s.stamps.period
    if near2 <= noise2:
        add_newest_interval(s, 1.0)
        return
    share = 1.0 - noise2 / near2
    kept = max(1.0 - share * s.stamps.period / p.tuning.stamp_time_s, 0.0)
    queue.unexplained = kept * queue.unexplained + share * min(min(once2, twice2) / near2, ROUGH)
    queue.count = kept * queue.count + share
    usual2 = (queue.unexplained + ROUGH) / (queue.count + 1.0) * near2
    # of deviations in three axes with Student's distribution, three degrees of freedom: motion is not always smooth
    add_newest_interval(s, ((usual2 + once2) / (usual2 + twice2)) ** 3)


@kernel
def add_newest_interval(s: State, likelihood_ratio: float) -> None:
    """With the probability that a sample is lost in it."""
    queue, odds = s.queue, LOSS_PROBABILITY * likelihood_ratio
    probability = odds / (1.0 + odds)
    queue.weight += probability
    for i in range(3):
        queue.rate[i] += probability * queue.newest_rate[i]
        queue.force[i] += probability * queue.newest_force[i]
        queue.square += probability * queue.newest_rate[i] ** 2


@kernel
def find_lost(p: Parameters, s: State, w: Vector, f: Vector, lost_s: float) -> None:
    """The queue lacks samples of this time, s; rate w and force f come after it.

    What they read in the mean becomes s.imu.gap_w and s.imu.gap_f, in the body's axes of now, and what they may have
    turned otherwise noise.
    """
    weigh_newest_interval(p, s, w)
    store_interval(s, w, f)
    add_newest_interval(s, 1.0)
    queue, q, k = s.queue, s.nav.q_nb, 1.0 / s.queue.weight
    rate = (k * queue.rate[0], k * queue.rate[1], k * queue.rate[2])
    force = (k * queue.force[0], k * queue.force[1], k * queue.force[2])
    variance = max(k * queue.square - dot(rate, rate), 0.0)
    add_noise(s, variance * lost_s * lost_s, 0.0)
    at = (q[0], q[1], q[2], q[3])
    set_gap(s, quat_rotate_back(at, rate), quat_rotate_back(at, force))
