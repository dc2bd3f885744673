r"""What remains between the tip that was commanded and the tip that the cameras see, and its correction.

Links or a calibration that differ from the description put the tip elsewhere than the model says:
:math:`d = x_{seen} - K(q_{commanded})` at one instant. Its slow part, :math:`\hat d`, is taken off the point aimed at:
the arm then rests where :math:`K(q) + \hat d` is the target, which is where the cameras see the tip on it.

The difference is one of model and measurement, not of target and tip: it does not wind up while the arm is on its way
to a target, at a limit, stopped, or short of a target that is out of reach. Neither does it touch the estimate of the
joints, which goes on to explain what the cameras see: the two have no variable in common.
"""

import math

from armsight_control.bodies import Seen
from armsight_control.chain import Array

CORRECTION_TIME_S = 0.25
"""Slower than the arm's own response (some 0.1 s), faster than the error changes along a path."""
# Vision must know the tip this well: a half-hidden marker is off by more than what is to be corrected.
_SIGMA_M = 0.03
# Faster than this a delay that is wrong by 5 ms looks like an error of 5 mm.
_SPEED_M_S = 1.5
# Of an arm of 10 m: no more than 2.5 % of its reach of 6 m; what is farther off is no error of the model, the arm is
# blocked.
MOST_M = 0.15
_BLOCKED_M = 0.3


def corrected(
    correction: Array,
    seen: Seen | None,
    commanded: Array,
    speed_m_s: float,
    dt_s: float,
    time_s: float = CORRECTION_TIME_S,
    scale: float = 1.0,
) -> Array:
    """The correction after one more instant, base frame, metres.

    Args:
        correction: so far, base frame, metres.
        seen: the tip by its markers, if they can be seen.
        commanded: where the setpoint of the same instant puts it.
        speed_m_s: of the commanded tip.
        dt_s: since the last instant.
        time_s: in which a difference is taken over, all but a third.
        scale: of the arm, :attr:`~armsight_control.chain.Chain.scale`.
    """
    if seen is None or seen.sigma_m > _SIGMA_M or speed_m_s > _SPEED_M_S:
        return correction
    difference = seen.position - commanded
    if math.hypot(*difference.tolist()) > _BLOCKED_M * scale:
        return correction
    after = correction + (1 - math.exp(-dt_s / time_s)) * (difference - correction)
    size = math.hypot(*after.tolist())
    return after * min(1.0, MOST_M * scale / size) if size > 0 else after
