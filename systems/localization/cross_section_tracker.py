"""Leaf: follows a needle's cross-section from slice to slice."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State, ValueProducer

from sonoservo.systems.localization.cross_section import (
    CrossSectionParameters,
    find_again,
    find_needle,
    start_at,
)
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.needle_shape import NeedleShape
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.requirements import require, require_not_negative


@dataclass(kw_only=True)
class CrossSectionTrackerParameters(CrossSectionParameters):
    """Of the tracker, besides how a cross-section is sought.

    Parameters
    ----------
    start
        x and y in P of the needle in the first slice, in m, as a person points at it; None lets
        the tracker find it by itself.
    start_slices
        Slices that the tracker then looks at before it starts: a needle stays, a fibre does not.
    follow_shape_from
        Observed depth from which the region of interest is centred on the predicted shape, in m;
        before that, on the last cross-section.
    """

    start: list[float] | None = None
    start_slices: int = 4
    follow_shape_from: float = 10e-3

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.start is not None:
            require(len(self.start) == 2, "start", self.start, "two coordinates in m")
        require(1 <= self.start_slices <= 20, "start_slices", self.start_slices, "from 1 to 20")
        require_not_negative(follow_shape_from=self.follow_shape_from)


@dataclass(frozen=True, eq=False)
class _Memory(Immutable):
    """What was found so far.

    Parameters
    ----------
    found
        In the newest slice.
    time
        Of the newest slice, in s.
    last
        The last cross-section found.
    images
        Slices seen before the start.
    """

    found: CrossSection | NotFound
    time: float = -np.inf
    last: CrossSection | None = None
    images: tuple[ImageSlice, ...] = ()


class CrossSectionTracker(LeafSystem):
    """Follows a needle's cross-section from slice to slice.

    .. pydrake_system::

        name: CrossSectionTracker
        input_ports:
        - slice
        - shape (optional)
        output_ports:
        - cross_section

    ``slice`` is an `ImageSlice`, or a `NotFound` while there is none; ``shape`` a `NeedleShape`, or
    a `NotFound`. ``cross_section`` is the `CrossSection` in the newest slice, or a `NotFound` that
    says why there is none.

    While the needle is not found, its last template is kept, and the region of interest follows
    the predicted shape.

    Parameters
    ----------
    parameters
        How it is sought.
    period, offset
        Of the events at which it takes note of a new slice, in s.
    """

    def __init__(
        self,
        *,
        parameters: CrossSectionTrackerParameters,
        period: float,
        offset: float = 0.0,
    ) -> None:
        super().__init__()
        self.set_name("cross_section_tracker")
        self._parameters = parameters
        image = self.DeclareAbstractInputPort("slice", Value[object](NotFound("no slice")))
        shape = self.DeclareAbstractInputPort("shape", Value[object](NotFound("no shape")))
        nothing = _Memory(NotFound("no slice yet"))
        self._memory = self.DeclareAbstractState(Value[object](nothing))
        memory_ticket = self.abstract_state_ticket(self._memory)
        after = self.DeclareCacheEntry(
            "after",
            ValueProducer(lambda: Value[object](nothing), self._calc_after),
            prerequisites_of_calc={image.ticket(), shape.ticket(), memory_ticket},
        )
        self._after = after
        self.DeclareAbstractOutputPort(
            "cross_section",
            lambda: Value[object](NotFound("no slice yet")),
            self._calc_cross_section,
            prerequisites_of_calc={after.ticket()},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self._update_memory)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update_memory)

    def _calc_cross_section(self, context: Context, output: Value) -> None:
        output.set_value(self._after.Eval(context).found)

    def _update_memory(self, context: Context, state: State) -> EventStatus:
        after = self._after.Eval(context)
        if after is context.get_abstract_state(self._memory).get_value():
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(self._memory).set_value(after)
        return EventStatus.Succeeded()

    def _calc_after(self, context: Context, output: Value) -> None:
        memory: _Memory = context.get_abstract_state(self._memory).get_value()
        image: Any = evaluate(self, context, "slice", (ImageSlice, NotFound))
        # A slice that has been looked at is not looked at again, with a template cut from itself.
        if isinstance(image, NotFound) or image.time <= memory.time:
            output.set_value(memory)
            return
        if memory.last is None:
            output.set_value(self._start(memory, image))
            return
        expected = self._expected(context, memory.last, image)
        found = find_again(image, memory.last, expected, self._parameters)
        last = found if isinstance(found, CrossSection) else memory.last
        output.set_value(_Memory(found, image.time, last))

    def _start(self, memory: _Memory, image: ImageSlice) -> _Memory:
        parameters = self._parameters
        if parameters.start is not None:
            centre: NDArray[np.float64] | NotFound = np.array(parameters.start)
        else:
            images = (*memory.images, image)
            if len(images) < parameters.start_slices:
                reason = NotFound("looking for what stays in the first slices")
                return _Memory(reason, image.time, images=images)
            lasting = np.min([each.intensities for each in images], axis=0)
            centre = find_needle(replace(image, intensities=lasting), parameters)
        found = start_at(image, centre, parameters) if isinstance(centre, np.ndarray) else centre
        last = found if isinstance(found, CrossSection) else None
        return _Memory(found, image.time, last)

    def _expected(
        self, context: Context, last: CrossSection, image: ImageSlice
    ) -> NDArray[np.float64]:
        """(2,) x and y in P, in m, where the needle is expected."""
        shape = None
        if self.GetInputPort("shape").HasValue(context):
            shape = evaluate(self, context, "shape", (NeedleShape, NotFound))
        if isinstance(shape, NeedleShape) and shape.observed >= self._parameters.follow_shape_from:
            depth = shape.X_WI.inverse().multiply(image.X_WP.translation())[2]
            p_W = shape.positions([depth])[0]
        else:
            p_W = last.position
        expected: NDArray[np.float64] = image.X_WP.inverse().multiply(p_W)[:2]
        return expected
