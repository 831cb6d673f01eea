"""Leaf system for a teleoperated phantom, which moves from rest to rest."""

from dataclasses import dataclass

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, LeafSystem, State
from pydrake.trajectories import Trajectory

from sonoservo.systems.robot.phantom_motion import (
    Breathing,
    Move,
    PhantomMotionParameters,
    next_move,
    phantom_trajectory,
)
from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.ports import declare_output

# Highest mean speeds along x, y, z in m/s, and in roll, pitch and yaw in deg/s.
_SPEED = (0.04, 0.04, 0.015, 30.0, 30.0, 30.0)


@dataclass(frozen=True, eq=False)
class OperatorMoves(Immutable):
    """Moves so far, and the resulting pose over time (see `phantom_trajectory`)."""

    moves: tuple[Move, ...]
    trajectory: Trajectory


class OperatorPhantomMotion(LeafSystem):
    """Moves the phantom to the target that an operator sets.

    .. pydrake_system::

        name: OperatorPhantomMotion
        input_ports:
        - phantom_target
        output_ports:
        - phantom_command

    `phantom_target` is the wanted displacement from the pose at rest: x, y, z in W in m, and yaw in
    rad. A move under way is finished before the next one begins. `phantom_command` is x, y, z in m
    and roll, pitch, yaw in rad of X_WT, and their rates in m/s and rad/s.

    The state is the list of moves so far. A `PhantomMotion` of these moves repeats the motion.

    Parameters
    ----------
    X_WT
        Pose at rest.
    breathing
        Periodic displacement, in addition to the operator's moves; None for none.
    period
        Sampling period of the target, in s.
    """

    def __init__(
        self, *, X_WT: RigidTransform, breathing: Breathing | None = None, period: float = 1 / 16
    ) -> None:
        super().__init__()
        self._X_WT, self._breathing = X_WT, breathing or Breathing()
        self.DeclareVectorInputPort("phantom_target", 4)
        self.DeclareAbstractState(Value[object](self._driven(())))
        tickets = self.time_ticket(), self.xa_ticket()
        declare_output(self, "phantom_command", 12, self._calc_phantom_command, tickets)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)

    def moves(self, context: Context) -> list[Move]:
        """Return the moves so far."""
        return list(self._state(context).moves)

    def _driven(self, moves: tuple[Move, ...]) -> OperatorMoves:
        parameters = PhantomMotionParameters(moves=list(moves), breathing=self._breathing)
        return OperatorMoves(moves, phantom_trajectory(parameters, self._X_WT))

    def _state(self, context: Context) -> OperatorMoves:
        driven: OperatorMoves = context.get_abstract_state(0).get_value()
        return driven

    def _update(self, context: Context, state: State) -> None:
        moves = self._state(context).moves
        x, y, z, yaw = self.GetInputPort("phantom_target").Eval(context)
        target = [x, y, z, 0.0, 0.0, np.round(np.rad2deg(yaw), 6)]
        move = next_move(moves, target, context.get_time(), speed=_SPEED)
        if move is not None:
            state.get_mutable_abstract_state(0).set_value(self._driven((*moves, move)))

    def _calc_phantom_command(self, context: Context, output: BasicVector) -> None:
        trajectory, time = self._state(context).trajectory, context.get_time()
        output.SetFromVector(
            np.concatenate([trajectory.value(time), trajectory.EvalDerivative(time)]).ravel()
        )
