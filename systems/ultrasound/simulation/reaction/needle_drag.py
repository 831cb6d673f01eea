"""Tissue dragged along by a needle: stick-slip and relaxation."""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from sonoservo.systems.signals.requirements import Bounded, Positive, within

_REST = 1e-9


@dataclass(kw_only=True)
class NeedleDragParameters(Bounded):
    """Parameters of the friction between needle and tissue.

    Parameters
    ----------
    distance
        Distance in m by which the needle drags tissue at its shaft before it slips; 0 for none.
    reach
        Distance from the shaft over which the drag falls to 1/e, in m.
    kept
        Share of ``distance`` at which tissue that slides back sticks to the needle again.
    slip_time
        Time in s that tissue takes to slide back.
    relaxation_time
        Time constant in s with which dragged tissue returns, also while it sticks to the needle.
    """

    distance: Annotated[float, within(0, 0.02, " m")] = 0.0
    reach: Annotated[float, within(2e-3, 0.1, " m")] = 8e-3
    kept: Annotated[float, within(0, 0.95)] = 0.6
    slip_time: Annotated[float, within(0.01, 10, " s")] = 0.1
    relaxation_time: Positive = 2.0


class Drag(NamedTuple):
    """State of the tissue at the needle's shaft."""

    distance: float = 0.0
    """Displacement towards the tip, in m."""
    slides: bool = False
    """True while it slides back along the needle."""


def advance_drag(
    drag: Drag, advance: float, duration: float, parameters: NeedleDragParameters
) -> Drag:
    """Return the drag after a needle has moved at a constant speed.

    As in Karnopp's friction model of needle insertion (Okamura, Simone and O'Leary 2004), tissue
    sticks to the needle and moves with it until the elastic force of the displaced tissue, which is
    proportional to its displacement s, exceeds static friction. It then slides back until the force
    has fallen to that of sliding friction, and sticks again. Tissue that sticks relaxes with the
    time constant tau:

        ds/dt = v - s / tau            while |s| < distance,
        ds/dt = -+ (1 - kept) distance / slip_time     from distance to kept x distance.

    Both are solved in closed form, so the result does not depend on the size of the steps.

    Parameters
    ----------
    drag
        Drag at the beginning.
    advance
        Distance in m by which the needle moves, negative for a withdrawal.
    duration
        Duration of the motion, in s.
    parameters
        Parameters of the friction.
    """
    most, tau = parameters.distance, parameters.relaxation_time
    s, slides = drag
    left = duration
    speed = advance / duration if duration > 0 else 0.0
    back = (1 - parameters.kept) * most / parameters.slip_time
    while left > _REST and most > 0:
        if slides:
            needed = (abs(s) - parameters.kept * most) / back
            step = min(max(needed, 0.0), left)
            s -= np.sign(s) * back * step
            slides = needed > left
        else:
            rest = speed * tau
            step = left
            end = rest + (s - rest) * np.exp(-left / tau)
            if abs(end) > most:
                limit = np.sign(end) * most
                step = min(max(-tau * np.log((limit - rest) / (s - rest)), 0.0), left)
                end, slides = limit, True
            s = end
        left -= step
    return Drag(float(s), bool(slides))
