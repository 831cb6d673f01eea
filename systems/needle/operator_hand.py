"""Leaf: a hand that an operator drives, kept as the pushes of an insertion."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem, State

from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.needle.insertion_parameters import Push
from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.requirements import require_positive


@dataclass(kw_only=True)
class OperatorHandParameters:
    """How a hand follows what an operator wants.

    Parameters
    ----------
    period
        Between its decisions, in s.
    speed
        Highest, of the needle along its axis, in m/s. A needle that is pushed in much faster has
        come to rest before enough volumes show it move, and is not noticed.
    turning_deg
        Fastest turning of the needle about its axis, in deg/s.
    """

    period: float = 1 / 16
    speed: float = 0.012
    turning_deg: float = 90.0

    def __post_init__(self) -> None:
        require_positive(period=self.period, speed=self.speed, turning_deg=self.turning_deg)


@dataclass(frozen=True, eq=False)
class OperatorInsertion(Immutable):
    """An insertion so far.

    Parameters
    ----------
    insertion
        Of all pushes so far.
    depth, turn_deg
        What these come to once the hand has caught up with them, in m and deg.
    """

    insertion: Insertion
    depth: float = 0.0
    turn_deg: float = 0.0


class OperatorHand(LeafSystem):
    """Pushes, withdraws and turns a needle to where an operator wants it.

    .. pydrake_system::

        name: OperatorHand
        input_ports:
        - needle_target
        output_ports:
        - needle

    `needle_target` is the wanted inserted length in m (below zero: outside), and the wanted angle
    of the needle about its axis, azimuth and dip of its direction in rad. Azimuth and dip are
    followed only while the needle is outside: in tissue a stiff needle cannot swing. `needle` is
    the inserted `Needle` in T.

    The state is the insertion of all pushes so far: a `Hand` of it moves the needle in the same way
    again. The hand changes its speed smoothly, see `InsertionParameters`, and does not overshoot.

    Parameters
    ----------
    make_insertion
        From pushes, one after the other from the start of time.
    parameters
        How the hand follows.
    """

    def __init__(
        self,
        *,
        make_insertion: Callable[[list[Push]], Insertion],
        parameters: OperatorHandParameters | None = None,
    ) -> None:
        super().__init__()
        self._make_insertion = make_insertion
        self._parameters = parameters or OperatorHandParameters()
        start = OperatorInsertion(make_insertion([]))
        empty = start.insertion.needle(-1.0)
        self.DeclareVectorInputPort("needle_target", 4)
        self.DeclareAbstractState(Value[object](start))
        self.DeclareAbstractOutputPort(
            "needle",
            lambda: Value[object](empty),
            self._calc_needle,
            prerequisites_of_calc={self.time_ticket(), self.xa_ticket()},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._parameters.period, 0.0, self._update)

    def insertion(self, context: Context) -> Insertion:
        """Return the insertion of all pushes so far."""
        return self._driven(context).insertion

    def is_held(self, context: Context) -> bool:
        """Whether the needle cannot be aimed as wanted, because it is in the tissue."""
        insertion = self.insertion(context)
        target = self.GetInputPort("needle_target").Eval(context)
        return bool(new_aim(insertion, target)) and not insertion.is_outside(context.get_time())

    def _driven(self, context: Context) -> OperatorInsertion:
        driven: OperatorInsertion = context.get_abstract_state(0).get_value()
        return driven

    def _update(self, context: Context, state: State) -> None:
        driven = self._driven(context)
        target = self.GetInputPort("needle_target").Eval(context)
        push = next_push(driven, target, context.get_time(), self._parameters)
        state.get_mutable_abstract_state(0).set_value(
            OperatorInsertion(
                self._make_insertion(appended(driven.insertion.parameters.pushes, push)),
                driven.depth + push.duration * push.speed,
                driven.turn_deg + push.duration * push.turning_deg,
            )
        )

    def _calc_needle(self, context: Context, output: Value) -> None:
        output.set_value(self.insertion(context).needle(context.get_time()))


def next_push(
    driven: OperatorInsertion,
    target: NDArray[np.float64],
    time: float,
    parameters: OperatorHandParameters,
) -> Push:
    """Return what the hand does in the next period.

    Parameters
    ----------
    driven
        What it has done.
    target
        (4,) inserted length in m, angle about the axis, azimuth and dip in rad.
    time
        Now, in s.
    parameters
        How the hand follows.
    """
    period = parameters.period
    depth, turn_deg = float(target[0]), float(np.rad2deg(target[1]))
    return Push(
        duration=period,
        speed=_limited((depth - driven.depth) / period, parameters.speed),
        turning_deg=_limited((turn_deg - driven.turn_deg) / period, parameters.turning_deg),
        **(new_aim(driven.insertion, target) if driven.insertion.is_outside(time) else {}),
    )


def new_aim(insertion: Insertion, target: NDArray[np.float64]) -> dict[str, Any]:
    """Return azimuth and dip in deg, of those that a target (see `next_push`) changes, by name."""
    wanted = np.round(np.rad2deg(target[2:]), 6).tolist()
    aims = zip(("azimuth_deg", "dip_deg"), wanted, insertion.direction_deg, strict=True)
    return {name: value for name, value, now in aims if value != round(now, 6)}


def appended(pushes: list[Push], push: Push) -> list[Push]:
    """Return the pushes and one more; it prolongs the last one where nothing changes."""
    if pushes and not push.aim:
        last = pushes[-1]
        if (last.speed, last.turning_deg) == (push.speed, push.turning_deg):
            return [*pushes[:-1], replace(last, duration=last.duration + push.duration)]
    return [*pushes, push]


def _limited(value: float, most: float) -> float:
    return min(max(value, -most), most)
