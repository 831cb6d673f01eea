"""Leaf systems that push a needle, as a hand or a template does, or to an operator's target."""

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
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.ports import declare_output


class Hand(LeafSystem):
    """Pushes a needle into the tissue, as a function of time alone.

    .. pydrake_system::

        name: Hand
        output_ports:
        - needle

    ``needle`` is the inserted `Needle` in the tissue frame T. It moves with the tissue.

    Parameters
    ----------
    insertion
        Path and motion of the needle.
    """

    def __init__(self, *, insertion: Insertion) -> None:
        super().__init__()
        self.set_name("hand")
        self._insertion = insertion
        declare_output(self, "needle", Needle, self._calc_needle, {self.time_ticket()})

    def _calc_needle(self, context: Context, output: Value) -> None:
        output.set_value(self._insertion.needle(context.get_time()))


_PERIOD = 1 / 16  # sampling period of an operator's target, in s

SPEED = 0.012
"""Highest speed of the needle along its axis, in m/s: several volumes show a needle that is pushed
no faster while it moves."""

TURNING_DEG = 90.0  # highest rate at which the needle is turned about its axis, in deg/s


@dataclass(frozen=True, eq=False)
class OperatorInsertion(Immutable):
    """Teleoperated insertion so far."""

    insertion: Insertion
    depth: float = 0.0  # once the hand has caught up, in m
    turn_deg: float = 0.0


class OperatorHand(LeafSystem):
    """Pushes, withdraws and turns a needle to an operator's target.

    .. pydrake_system::

        name: OperatorHand
        input_ports:
        - needle_target
        output_ports:
        - needle

    `needle_target` has four elements: the wanted inserted length in m (negative if outside), the
    angle of the needle about its axis, and azimuth and dip of its direction, in rad. Azimuth and
    dip are followed while the needle is outside or, if it is straight, withdrawn to 20 mm, because
    a stiff needle cannot swing deep in tissue. `needle` is the inserted `Needle` in T.

    The state is the insertion by all pushes so far. A `Hand` with this insertion repeats the
    motion. The hand changes its speed smoothly (see `InsertionParameters`) and does not overshoot.

    Parameters
    ----------
    make_insertion
        Function that makes an insertion from successive pushes, the first of which starts at time
        zero.
    """

    def __init__(self, *, make_insertion: Callable[[list[Push]], Insertion]) -> None:
        super().__init__()
        self._make_insertion = make_insertion
        insertion = make_insertion([])
        start = OperatorInsertion(insertion, insertion.parameters.initial_depth or 0.0)
        self.DeclareVectorInputPort("needle_target", 4)
        self.DeclareAbstractState(Value[object](start))
        declare_output(
            self, "needle", Needle, self._calc_needle, {self.time_ticket(), self.xa_ticket()}
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(_PERIOD, 0.0, self._update)

    def insertion(self, context: Context) -> Insertion:
        """Return the insertion by all pushes so far."""
        return self._driven(context).insertion

    def is_held(self, context: Context) -> bool:
        """Return True if the needle cannot be aimed as wanted because it is in the tissue."""
        insertion = self.insertion(context)
        target = self.GetInputPort("needle_target").Eval(context)
        return bool(new_aim(insertion, target)) and not _can_follow(
            insertion, target, context.get_time()
        )

    def _driven(self, context: Context) -> OperatorInsertion:
        driven: OperatorInsertion = context.get_abstract_state(0).get_value()
        return driven

    def _update(self, context: Context, state: State) -> None:
        driven = self._driven(context)
        target = self.GetInputPort("needle_target").Eval(context)
        push = next_push(driven, target, context.get_time())
        state.get_mutable_abstract_state(0).set_value(
            OperatorInsertion(
                self._make_insertion(appended(driven.insertion.parameters.pushes, push)),
                driven.depth + push.duration * push.speed,
                driven.turn_deg + push.duration * push.turning_deg,
            )
        )

    def _calc_needle(self, context: Context, output: Value) -> None:
        output.set_value(self.insertion(context).needle(context.get_time()))


def next_push(driven: OperatorInsertion, target: NDArray[np.float64], time: float) -> Push:
    """Return the hand's push in the next period."""
    depth, turn_deg = float(target[0]), float(np.rad2deg(target[1]))
    aim = new_aim(driven.insertion, target) if _can_follow(driven.insertion, target, time) else {}
    return Push(
        duration=_PERIOD,
        speed=_limited((depth - driven.depth) / _PERIOD, SPEED),
        turning_deg=_limited((turn_deg - driven.turn_deg) / _PERIOD, TURNING_DEG),
        **aim,
    )


def new_aim(insertion: Insertion, target: NDArray[np.float64]) -> dict[str, Any]:
    """Return by name those of azimuth and dip, in deg, that a target (see `next_push`) changes."""
    wanted = np.round(np.rad2deg(target[2:]), 6).tolist()
    aims = zip(("azimuth_deg", "dip_deg"), wanted, insertion.direction_deg, strict=True)
    return {name: value for name, value, now in aims if value != round(now, 6)}


def _can_follow(insertion: Insertion, target: NDArray[np.float64], time: float) -> bool:
    """Return True if the needle may be aimed as a target (see `next_push`) wants it."""
    azimuth_deg, dip_deg = np.rad2deg(target[2:]).tolist()
    return insertion.can_aim(time, azimuth_deg, dip_deg)


def appended(pushes: list[Push], push: Push) -> list[Push]:
    """Return the pushes with one more, which prolongs the last one if nothing changes."""
    if pushes and not push.aim:
        last = pushes[-1]
        if (last.speed, last.turning_deg) == (push.speed, push.turning_deg):
            return [*pushes[:-1], replace(last, duration=last.duration + push.duration)]
    return [*pushes, push]


def _limited(value: float, most: float) -> float:
    return min(max(value, -most), most)
