"""Leaf system that delays a pose, as the way from an arm or a tracker to a program does."""

import math
from dataclasses import dataclass

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate
from sonoservo.systems.signals.random_streams import random_stream
from sonoservo.systems.signals.requirements import (
    Bounded,
    NotNegative,
    require_not_negative,
    require_positive,
)


@dataclass(kw_only=True)
class PoseDelayParameters(Bounded):
    """Delay of the probe's pose on its way to the program.

    Parameters
    ----------
    delay
        Mean age of the probe's pose when the program reads it as the present one, in s.
    jitter
        Standard deviation of the age of the probe's pose, in s.
    """

    delay: NotNegative = 0.0
    jitter: NotNegative = 0.0


@dataclass(frozen=True)
class _Poses(Immutable):
    """Poses at the latest events, and the number of the last of these."""

    last: int = -1
    poses: tuple[RigidTransform, ...] = ()


class PoseDelay(LeafSystem):
    """Delays the pose of a body whose motion is computed in steps.

    .. pydrake_system::

        name: PoseDelay
        input_ports:
        - pose
        output_ports:
        - delayed_pose

    Both are RigidTransforms. The output is the input of a time ago: exactly the delay, if there is
    no jitter. Each step has a normally distributed age of its own, at least 0. Before time 0 the
    body is at rest.

    Parameters
    ----------
    parameters
        Delay and jitter.
    period
        Time step in s of the plant that moves the body; the pose is constant within a step.
    seed
        Seed of the jitter. Equal seeds and times give equal ages.
    """

    def __init__(self, *, parameters: PoseDelayParameters, period: float, seed: int):
        super().__init__()
        require_positive(period=period)
        require_not_negative(seed=seed)
        self._parameters, self._period, self._seed = parameters, period, seed
        self._kept = math.ceil((parameters.delay + 6 * parameters.jitter) / period) + 2
        declare_inputs(self, pose=RigidTransform)
        self._poses = self.DeclareAbstractState(Value[object](_Poses()))
        declare_output(self, "delayed_pose", RigidTransform, self._calc_delayed_pose)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update_poses)

    def _step(self, time: float) -> int:
        """Return the number of the step that ends at a time or goes on at it."""
        return math.ceil(time / self._period - 1e-6)

    def _update_poses(self, context: Context, state: State) -> EventStatus:
        kept = context.get_abstract_state(self._poses).get_value()
        # Copied, because an input's value changes in place.
        pose = RigidTransform(evaluate(self, context, "pose", RigidTransform))
        poses = (*kept.poses, pose)[-self._kept :]
        state.get_mutable_abstract_state(self._poses).set_value(
            _Poses(self._step(context.get_time()), poses)
        )
        return EventStatus.Succeeded()

    def _calc_delayed_pose(self, context: Context, output: Value) -> None:
        kept = context.get_abstract_state(self._poses).get_value()
        back = kept.last - self._step(context.get_time() - self._age(context.get_time()))
        if back < 0 or not kept.poses:
            output.set_value(evaluate(self, context, "pose", RigidTransform))
        else:
            output.set_value(kept.poses[-1 - min(back, len(kept.poses) - 1)])

    def _age(self, time: float) -> float:
        delay, jitter = self._parameters.delay, self._parameters.jitter
        if jitter == 0:
            return delay
        rng = random_stream(self._seed, "pose", self._step(time) * self._period)
        return max(delay + jitter * rng.standard_normal(), 0.0)
