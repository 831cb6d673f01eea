"""Leaf system that remembers a needle's cross-sections from slice to slice."""

from typing import Any

from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from sonoservo.systems.signals.cross_section import CrossSection, CrossSectionTrack
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import declare_inputs, declare_state_output, evaluate


class CrossSectionMemory(LeafSystem):
    """Remembers the cross-section found last, and the slices before the first cross-section.

    .. pydrake_system::

        name: CrossSectionMemory
        input_ports:
        - slice
        - cross_section
        output_ports:
        - cross_section_track

    ``slice`` is an `ImageSlice`, or a `NotFound` while there is none. ``cross_section`` is the
    `CrossSection` in it, or a `NotFound`. ``cross_section_track`` is the `CrossSectionTrack` after
    the last event. It depends on the state only, so the localizer may use it.

    Parameters
    ----------
    start_slices
        Number of slices in one attempt to find the first cross-section. The attempt ends with the
        last of them.
    period, offset
        Period and offset in s of the events that store a new slice.
    """

    def __init__(self, *, start_slices: int = 1, period: float, offset: float = 0.0) -> None:
        super().__init__()
        self.set_name("cross_section_memory")
        self._start_slices = start_slices
        declare_inputs(self, slice=(ImageSlice, NotFound), cross_section=(CrossSection, NotFound))
        track = self.DeclareAbstractState(Value[object](CrossSectionTrack()))
        declare_state_output(self, "cross_section_track", CrossSectionTrack, track)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self._update)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update)

    def _update(self, context: Context, state: State) -> EventStatus:
        track: CrossSectionTrack = context.get_abstract_state(0).get_value()
        image = evaluate(self, context, "slice", (ImageSlice, NotFound))
        if not isinstance(image, ImageSlice) or image.time <= track.time:
            return EventStatus.DidNothing()
        found: Any = evaluate(self, context, "cross_section", (CrossSection, NotFound))
        state.get_mutable_abstract_state(0).set_value(
            remembered(track, image, found, self._start_slices)
        )
        return EventStatus.Succeeded()


def remembered(
    track: CrossSectionTrack, image: ImageSlice, found: CrossSection | NotFound, start_slices: int
) -> CrossSectionTrack:
    """Return the track after one more slice and the cross-section in it."""
    last = found if isinstance(found, CrossSection) else track.last
    images = () if last is not None else (*track.images, image)
    # After a failed attempt, the next one begins with new slices.
    return CrossSectionTrack(found, image.time, last, images if len(images) < start_slices else ())
