"""Reaction of the tissue to probe and needle: a leaf, and the needle's drag by stick and slip."""

from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate
from sonoservo.systems.signals.requirements import (
    Bounded,
    Fraction,
    Positive,
    require_positive,
    within,
)
from sonoservo.systems.ultrasound.simulation.reaction.deformation import (
    Deformation,
    Indentation,
    indentation,
)

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
    """Return the drag after a needle has moved ``advance`` m at constant speed in ``duration`` s.

    Withdrawal is negative. The result does not depend on the size of the steps.
    """
    # As in Karnopp's friction model of needle insertion (Okamura, Simone and O'Leary 2004), tissue
    # sticks to the needle and moves with it until its elastic force, proportional to the
    # displacement s, exceeds static friction. It then slides back until the force has fallen to
    # that of sliding friction, and sticks again. Tissue that sticks relaxes with the time constant
    # tau. Both are solved in closed form:
    #
    #     ds/dt = v - s / tau            while |s| < distance,
    #     ds/dt = -+ (1 - kept) distance / slip_time     from distance to kept x distance.
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


@dataclass(kw_only=True)
class TissueReactionParameters(Bounded):
    """Parameters of the tissue's reaction to probe and needle.

    Parameters
    ----------
    drag
        Friction between needle and tissue.
    pushed_aside
        Share of the needle's volume to which the tissue gives way: 0 for none, 1 for a stiff needle
        in incompressible tissue.
    indentation
        Whether tissue and needle move with the indentation by the probe.
    """

    drag: NeedleDragParameters = field(default_factory=NeedleDragParameters)
    pushed_aside: Fraction = 0.0
    indentation: bool = False

    @property
    def acts(self) -> bool:
        """True if the tissue reacts at all."""
        return self.indentation or self.pushed_aside > 0 or self.drag.distance > 0


def tissue_deformation(
    needle: Needle,
    drag: Drag,
    X_TP: RigidTransform,
    dome_radius: float,
    parameters: TissueReactionParameters,
) -> Deformation:
    """Return the deformation by a needle in T as pushed and a probe; see `indentation`."""
    return Deformation(
        indentation(X_TP, dome_radius) if parameters.indentation else Indentation(),
        needle.shaft,
        drag.distance,
        parameters.drag.reach,
        needle.radius * parameters.pushed_aside**0.5,
    )


class TissueReaction(LeafSystem):
    """Deforms the tissue where the probe presses it and the needle moves in it.

    .. pydrake_system::

        name: TissueReaction
        input_ports:
        - true_X_WP
        - X_WT
        - pushed_needle
        output_ports:
        - needle
        - deformation

    `true_X_WP` and `X_WT` are the true poses of probe and tissue (RigidTransform), and
    `pushed_needle` is the `Needle` in T as if the tissue were at rest. `deformation` is the
    `Deformation` of the tissue. `needle` is the true needle in T: the probe displaces it together
    with the tissue around it.

    The state is the drag of the tissue by the needle at the last sample, and the time and inserted
    length then. Between samples the needle's speed counts as constant.

    Parameters
    ----------
    parameters
        Parameters of the reaction.
    dome_radius
        Radius of the probe's face, in m; see `indentation`.
    period
        Sampling period of the needle's motion, in s.
    """

    def __init__(
        self, *, parameters: TissueReactionParameters, dome_radius: float, period: float = 1 / 64
    ) -> None:
        super().__init__()
        require_positive(dome_radius=dome_radius, period=period)
        self._parameters, self._dome_radius = parameters, dome_radius
        self.DeclareAbstractInputPort("true_X_WP", Value(RigidTransform()))
        self.DeclareAbstractInputPort("X_WT", Value(RigidTransform()))
        declare_inputs(self, pushed_needle=Needle)
        self.DeclareDiscreteState(4)  # time, inserted length, drag, and 1 while the tissue slides
        declare_output(self, "needle", Needle, self._calc_needle)
        declare_output(self, "deformation", Deformation, self._calc_deformation)
        if parameters.drag.distance > 0:
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _drag(self, context: Context, needle: Needle) -> Drag:
        """Return the drag at present."""
        if not needle:
            return Drag()
        time, length, distance, slides = context.get_discrete_state_vector().value()
        elapsed = context.get_time() - time
        # A needle that was outside drags nothing until it is in.
        advance = needle.length - length if length > 0 else 0.0
        return advance_drag(Drag(distance, slides > 0), advance, elapsed, self._parameters.drag)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        needle = evaluate(self, context, "pushed_needle", Needle)
        drag = self._drag(context, needle)
        length = needle.length if needle else 0.0
        state.set_value([context.get_time(), length, drag.distance, float(drag.slides)])

    def _calc_deformation(self, context: Context, output: Value) -> None:
        needle = evaluate(self, context, "pushed_needle", Needle)
        X_WP = evaluate(self, context, "true_X_WP", RigidTransform)
        X_WT = evaluate(self, context, "X_WT", RigidTransform)
        output.set_value(
            tissue_deformation(
                needle,
                self._drag(context, needle),
                X_WT.InvertAndCompose(X_WP),
                self._dome_radius,
                self._parameters,
            )
        )

    def _calc_needle(self, context: Context, output: Value) -> None:
        needle = evaluate(self, context, "pushed_needle", Needle)
        deformed: Deformation = self.GetOutputPort("deformation").Eval(context)
        output.set_value(deformed.moved_needle(needle))
