"""Leaf system that follows all lines of the volumes, of which one may be a needle."""

from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.line_hypotheses import LineHypotheses, LinesExplanation
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate
from sonoservo.systems.signals.requirements import require_not_negative, require_positive
from sonoservo.systems.signals.search_reason import SearchReason
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.line_belief import LineBelief, explain_lines, follow


class LineFollower(LeafSystem):
    """Follows all lines of the volumes, and tells which may be a needle.

    .. pydrake_system::

        name: LineFollower
        input_ports:
        - volume
        - estimate (optional)
        output_ports:
        - lines
        - belief
        - explanation

    ``estimate`` is the `NeedleEstimate` before the volume. While it surely shows the needle, the
    other lines are not needed, and they are forgotten. ``lines`` are the `LineHypotheses` after the
    volume at the input, and ``belief`` the `LineBelief` from which they follow; they are a
    `NotFound` if there are none. They depend on the state, on the estimate and on that volume.
    ``explanation`` is the `LinesExplanation` of the lines, computed on demand.

    Parameters
    ----------
    anywhere
        Whether lines at rest are judged by their looks from the first volume on. If not, they are
        once a needle is no longer seen.
    sure
        Least probability of the estimate with which it surely shows the needle.
    period, offset
        Period and offset of the event, in s.
    """

    def __init__(
        self,
        *,
        anywhere: bool = False,
        sure: float = 0.0,
        period: float,
        offset: float = 0.0,
    ) -> None:
        super().__init__()
        require_positive(period=period)
        require_not_negative(offset=offset)
        self._anywhere, self._sure = anywhere, sure
        declare_inputs(self, volume=(Volume, NotFound), estimate=NeedleEstimate)
        self._belief = self.DeclareAbstractState(Value[object](LineBelief()))
        inputs = {self.all_input_ports_ticket(), self.abstract_state_ticket(self._belief)}
        self._after = declare_output(
            self, "belief", (LineBelief, NotFound), self._calc_belief, inputs
        )
        declare_output(self, "lines", (LineHypotheses, NotFound), self._calc_lines, inputs)
        declare_output(
            self, "explanation", (LinesExplanation, NotFound), self._calc_explanation, inputs
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self._update)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update)

    def _calc_belief(self, context: Context, output: Value) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        belief: LineBelief = context.get_abstract_state(self._belief).get_value()
        if not isinstance(volume, Volume):
            output.set_value(volume)
        elif volume.time <= belief.time:
            output.set_value(belief)
        else:
            output.set_value(self._followed(context, belief, volume))

    def _followed(self, context: Context, belief: LineBelief, volume: Volume) -> LineBelief:
        look = self._anywhere
        if self.GetInputPort("estimate").HasValue(context):
            estimate = evaluate(self, context, "estimate", NeedleEstimate)
            if estimate.mode == TrackingMode.TRACKING and estimate.probability >= self._sure:
                return belief.rested(volume)
            look |= estimate.mode != TrackingMode.SEARCHING
        return follow(belief, volume, look=look)

    def _calc_lines(self, context: Context, output: Value) -> None:
        belief = self._after.Eval(context)
        if isinstance(belief, LineBelief):
            followed = NotFound(SearchReason.TRACKED())
            belief = belief.hypotheses if belief.memory else followed
        output.set_value(belief)

    def _calc_explanation(self, context: Context, output: Value) -> None:
        belief = self._after.Eval(context)
        output.set_value(explain_lines(belief) if isinstance(belief, LineBelief) else belief)

    def _update(self, context: Context, state: State) -> EventStatus:
        belief = self._after.Eval(context)
        if not isinstance(belief, LineBelief):
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(self._belief).set_value(belief)
        return EventStatus.Succeeded()
