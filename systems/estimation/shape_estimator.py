"""The face that all shape estimators have."""

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from sonoservo.systems.estimation.shape_parameters import ShapeEstimatorParameters
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.needle_shape import NeedleShape
from sonoservo.systems.signals.ports import evaluate


@dataclass(frozen=True, eq=False)
class _Memory(Immutable):
    """What an estimator believes, and since when.

    Parameters
    ----------
    belief
        Of the estimator.
    number
        Of cross-sections that were used; selects the random numbers.
    time, observed
        Of the last of them, in s, and its depth in m.
    X_WI
        Pose of the insertion's frame in W; None before it is known.
    reason
        Why the newest slice was not used.
    """

    belief: Any
    number: int = 0
    time: float = -np.inf
    observed: float = 0.0
    X_WI: RigidTransform | None = None
    reason: str = ""


class ShapeEstimator(LeafSystem):
    """Estimates a needle's shape from its cross-sections, one after the other.

    .. pydrake_system::

        name: ShapeEstimator
        input_ports:
        - cross_section
        output_ports:
        - shape

    ``cross_section`` is a `CrossSection`, or a `NotFound` when the slice did not show one.
    ``shape`` is a `NeedleShape` after the last event, or a `NotFound` until there is one. It
    depends on the state only: the tracker of cross-sections may use it.

    Parameters
    ----------
    parameters
        Depth, rotations and prior.
    X_WI
        Pose of the insertion's frame in W, from whose plane Z = 0 on depths count: that of the
        probe at the first slice. None takes the first slice in which the needle is found.
    period, offset
        Of the events at which it looks for a new cross-section, in s.
    seed
        Of every random choice.
    """

    def __init__(
        self,
        *,
        parameters: ShapeEstimatorParameters,
        X_WI: RigidTransform | None = None,
        period: float,
        offset: float = 0.0,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self._known = parameters
        self._seed = seed
        self.DeclareAbstractInputPort("cross_section", Value[object](NotFound("no slice")))
        memory = _Memory(self._begin(self._rng(0)), X_WI=X_WI)
        self._memory = self.DeclareAbstractState(Value[object](memory))
        self.DeclareAbstractOutputPort(
            "shape",
            lambda: Value[object](NotFound("no cross-section yet")),
            self._calc_shape,
            prerequisites_of_calc={self.abstract_state_ticket(self._memory)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self._update_memory)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update_memory)

    @abstractmethod
    def _begin(self, rng: np.random.Generator) -> Any:
        """Return the belief before any measurement."""

    @abstractmethod
    def _updated(self, belief: Any, p_I: NDArray[np.float64], rng: np.random.Generator) -> Any:
        """Return the belief after one more measurement, (3,) in the insertion's frame, in m."""

    @abstractmethod
    def _represented(self, belief: Any, rng: np.random.Generator) -> dict[str, Any] | NotFound:
        """Return the paths of a `NeedleShape`: parameters, origins, weights, origin_variance."""

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
        if self._known.observe_until is not None and p_I[2] > self._known.observe_until + 1e-9:
            return memory
        belief = self._updated(memory.belief, p_I, self._rng(memory.number + 1))
        return _Memory(belief, memory.number + 1, found.time, float(p_I[2]), X_WI)

    def _calc_shape(self, context: Context, output: Value) -> None:
        memory: _Memory = context.get_abstract_state(self._memory).get_value()
        if memory.X_WI is None or memory.number == 0:
            output.set_value(NotFound(memory.reason or "no cross-section yet"))
            return
        paths = self._represented(memory.belief, self._rng(memory.number))
        if isinstance(paths, NotFound):
            output.set_value(paths)
            return
        output.set_value(
            NeedleShape(
                **paths,
                rotations=tuple(self._known.rotations),
                depth=self._known.depth,
                observed=memory.observed,
                X_WI=memory.X_WI,
                time=memory.time,
                reason=memory.reason,
            )
        )
