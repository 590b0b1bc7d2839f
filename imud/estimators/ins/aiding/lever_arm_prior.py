"""How well the lever arm of the receiver's antenna is known: not set, set, measured or exact.

One that is set was measured with a ruler, or it is wrong: by a sign, of another antenna, a guess. So the error of each
component has either of two sigmas, `gnss_lever_arm_sigma` (the ruler's) or `set_lever_arm_sigma`, and both are as
probable before anything is known. Positions of centimetres show which. With a third one, rho,

    1 / rho^2 = 1 / ruler^2 - 1 / set^2,

the smaller prior is the larger one times the density of a measurement of the component, which gives that of the
settings with the sigma rho. The filter begins with the smaller one, that is, as if it were fused. The likelihood of all
fixes under the larger prior, over that under the smaller one, is then (Savage and Dickey)

    odds = exp(z^2 / 2 s) rho^2 / sqrt(s (set^2 + rho^2)),    s = rho^2 - P,

z being the settings' component less that of the estimate, and P its variance. At `lever_arm_odds` the measurement is
taken back: it is fused with the variance -rho^2. That is exact, with all cross-covariances, as far as the filter is
linear. Until then the stated sigmas have what the larger prior would add, times its probability.

That holds for a receiver at work, whose time offset is estimated, too. The epochs of a survey count as exact. There an
error of the time would go into the lever arm, which looks the same; so a lever arm that is set is as exact as they are,
and only `glr_tests.lever_arm_error` looks for an error of it.

Source: Dickey, The weighted likelihood ratio, linear hypotheses on normal location parameters, Ann. Math. Stat. 42
(1971).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imud.drivers import elementary

from ....compile.jit import kernel
from ...tuning import Tunable
from ..ekf import decorrelate, set_jacobian, variance
from ..fusion import NO_GATE, gated_update
from ..state import GNSS_LEVER_ARM, NAVIGATING, REPORTED_EPOCHS
from .gnss_noise import horizontal_sigma

if TYPE_CHECKING:
    from ...types import Fix
    from ..types import Core, Parameters


TUNABLES = (
    Tunable(
        "unset_lever_arm_sigma",
        1.0,
        "m",
        "Sigma of each component of a lever arm that the user has not set.",
        "Roofs of cars, masts of robots.",
    ),
    Tunable(
        "set_lever_arm_sigma",
        0.2,
        "m",
        "Sigma of each component of a lever arm that the user has set, but not measured.",
        "Open recordings contradict their own by 0.2 to 0.35 m.",
    ),
    Tunable(
        "gnss_lever_arm_sigma",
        0.03,
        "m",
        "Sigma of each component of a lever arm that the user measured, with a ruler.",
        "A ruler.",
    ),
    Tunable("lever_arm_odds", 20.0, "", "Odds from which a component is set wrong.", "Choice: 5 %."),
)
MOST_LOG_ODDS = 50.0


@kernel
def initial_lever_arm_sigma(p: Parameters, c: Core, fix: Fix) -> float:
    """1 sigma of each component of the lever arm, m: the user's, or what is assumed where he gives none.

    From the first position of centimetres on one that is set is taken for measured, or, with a survey, for exact.
    """
    if p.lever_arm_sigma >= 0.0:
        return float(p.lever_arm_sigma)
    if not p.lever_arm_is_set:
        return float(p.tuning.unset_lever_arm_sigma)
    measured = p.tuning.gnss_lever_arm_sigma if c.integrity.epochs == REPORTED_EPOCHS else 0.0
    precise = c.gnss.given_lever_arm_sigma == measured or horizontal_sigma(p, fix) < p.tuning.survey_sigma
    return float(measured if precise else p.tuning.set_lever_arm_sigma)


@kernel
def forget_lever_arm(c: Core) -> None:
    """What was estimated of the lever arm is wrong, as the heading was: begin with the user's at the next fix."""
    c.gnss.given_lever_arm_sigma = math.nan


@kernel
def set_gnss_lever_arm(p: Parameters, c: Core, fix: Fix) -> None:
    """Begin with the lever arm that the user gives, before the first fix and after a change of the setting."""
    g, sigma = c.gnss, initial_lever_arm_sigma(p, c, fix)
    changed = g.given_lever_arm_sigma != sigma
    for i in range(3):
        changed = changed or g.given_lever_arm[i] != p.gnss_lever_arm[i]
    if not changed:
        return
    g.given_lever_arm_sigma = sigma
    for i in range(3):
        g.given_lever_arm[i] = c.nav.gnss_lever_arm[i] = p.gnss_lever_arm[i]
        g.lever_arm_is_measured[i] = 1 if p.lever_arm_sigma < 0.0 and sigma == p.tuning.gnss_lever_arm_sigma else 0
        g.lever_arm_inflation[i] = 0.0
        decorrelate(c, GNSS_LEVER_ARM + i, sigma * sigma)


@kernel
def odds_of_mistake(p: Parameters, rho2: float, z: float, s: float) -> float:
    """Odds that a component is set wrong; see the file's head."""
    at_first = p.tuning.set_lever_arm_sigma**2 + rho2
    return float(elementary.exp(min(0.5 * z * z / s, MOST_LOG_ODDS)) * rho2 / math.sqrt(s * at_first))


@kernel
def weigh_lever_arm(p: Parameters, c: Core) -> bool:
    """After a fix: True if a component of the lever arm no longer counts as measured; then the correction is in
    scratch.x, not injected."""
    ruler2, set2 = p.tuning.gnss_lever_arm_sigma**2, p.tuning.set_lever_arm_sigma**2
    if c.alignment.mode != NAVIGATING or ruler2 >= set2:
        return False
    g, rho2 = c.gnss, ruler2 * set2 / (set2 - ruler2)
    for i in range(3):
        if g.lever_arm_is_measured[i] == 0:
            continue
        if variance(c, GNSS_LEVER_ARM + i) > ruler2:  # another fault has opened it: there is nothing to take back
            g.lever_arm_is_measured[i] = 0
            g.lever_arm_inflation[i] = 0.0
            continue
        z, known = p.gnss_lever_arm[i] - c.nav.gnss_lever_arm[i], variance(c, GNSS_LEVER_ARM + i)
        s = rho2 - known
        odds = odds_of_mistake(p, rho2, z, s)
        if odds > p.tuning.lever_arm_odds:
            gated_update(c, set_jacobian(c, 0, GNSS_LEVER_ARM + i, 1.0), z, -rho2, NO_GATE)
            g.lever_arm_is_measured[i] = 0
            g.lever_arm_inflation[i] = 0.0
            return True
        gain = known / s
        g.lever_arm_inflation[i] = odds / (1.0 + odds) * (known * gain + (gain * z) ** 2)
    return False
