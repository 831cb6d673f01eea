"""Leaf system that estimates the shape of a needle from its cross-sections with a shape filter."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from sonoservo.systems.shape.shape_filter import ShapeFilter
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.needle_shape import NeedleShape
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate


@dataclass(frozen=True, eq=False)
class _Memory(Immutable):
    """Belief of the filter; number, time and depth of its newest measurement; frame I."""

    belief: Any
    number: int = 0
    time: float = -np.inf
    observed: float = 0.0
    X_WI: RigidTransform | None = None
    reason: str = ""


class ShapeEstimator(LeafSystem):
    """Estimates the shape of a needle from its cross-sections, one after the other.

    .. pydrake_system::

        name: ShapeEstimator
        input_ports:
        - cross_section
        output_ports:
        - shape

    ``cross_section`` is a `CrossSection`, or a `NotFound` if the slice does not show one.
    ``shape`` is a `NeedleShape` after the last event, or a `NotFound` until there is one. It
    depends on the state only, so the localizer of cross-sections may use it.

    Parameters
    ----------
    shape_filter
        Shape filter, one of `SHAPE_FILTERS` or your own.
    X_WI
        Pose in W of the insertion's frame, which is the probe's frame at the first slice. Depths
        are measured from its plane Z = 0. None takes the first slice in which the needle is found.
    period, offset
        Period and offset in s of the events that take a new cross-section.
    seed
        Seed of every random choice.
    """

    def __init__(
        self,
        *,
        shape_filter: ShapeFilter,
        X_WI: RigidTransform | None = None,
        period: float,
        offset: float = 0.0,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.set_name("shape_estimator")
        self._filter = shape_filter
        self._seed = seed
        declare_inputs(self, cross_section=(CrossSection, NotFound))
        memory = _Memory(shape_filter.begin(self._rng(0)), X_WI=X_WI)
        self._memory = self.DeclareAbstractState(Value[object](memory))
        declare_output(
            self,
            "shape",
            (NeedleShape, NotFound),
            self._calc_shape,
            {self.abstract_state_ticket(self._memory)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self._update_memory)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update_memory)

    def _rng(self, number: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, number])

    def _update_memory(self, context: Context, state: State) -> EventStatus:
        found: Any = evaluate(self, context, "cross_section", (CrossSection, NotFound))
        memory: _Memory = context.get_abstract_state(self._memory).get_value()
        updated = self._after(memory, found)
        if updated is memory:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(self._memory).set_value(updated)
        return EventStatus.Succeeded()

    def _after(self, memory: _Memory, found: CrossSection | NotFound) -> _Memory:
        if isinstance(found, NotFound):
            if found.reason == memory.reason:
                return memory
            return replace(memory, reason=found.reason)
        if found.time <= memory.time:
            return memory
        X_WI = memory.X_WI or RigidTransform(found.X_WP)
        p_I = X_WI.inverse().multiply(found.position)
        limit = self._filter.parameters.observe_until
        if limit is not None and p_I[2] > limit + 1e-9:
            return memory
        belief = self._filter.update(memory.belief, p_I, self._rng(memory.number + 1))
        return _Memory(belief, memory.number + 1, found.time, float(p_I[2]), X_WI)

    def _calc_shape(self, context: Context, output: Value) -> None:
        memory: _Memory = context.get_abstract_state(self._memory).get_value()
        if memory.X_WI is None or memory.number == 0:
            output.set_value(NotFound(memory.reason or "no cross-section yet"))
            return
        paths = self._filter.represent(memory.belief, self._rng(memory.number))
        if isinstance(paths, NotFound):
            output.set_value(paths)
            return
        output.set_value(
            NeedleShape(
                **paths._asdict(),
                rotations=tuple(self._filter.parameters.rotations),
                depth=self._filter.parameters.depth,
                observed=memory.observed,
                X_WI=memory.X_WI,
                time=memory.time,
                reason=memory.reason,
            )
        )
