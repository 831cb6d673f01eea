"""The leaf that lets the tissue react to probe and needle."""

from dataclasses import dataclass, field

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate
from sonoservo.systems.signals.requirements import Bounded, Fraction, require_positive
from sonoservo.systems.ultrasound.simulation.reaction.deformation import (
    Deformation,
    Indentation,
    indentation,
)
from sonoservo.systems.ultrasound.simulation.reaction.needle_drag import (
    Drag,
    NeedleDragParameters,
    advance_drag,
)


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
    """Return the deformation of the tissue.

    Parameters
    ----------
    needle
        Needle in T as pushed, possibly empty; see `Deformation`.
    drag
        Drag of the tissue by the needle.
    X_TP, dome_radius
        Pose of the probe in the tissue, and radius of its dome in m; see `indentation`.
    parameters
        Parameters of the reaction.
    """
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
