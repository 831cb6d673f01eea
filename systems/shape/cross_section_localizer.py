"""Leaf system that localizes a needle's cross-section in a slice."""

from dataclasses import replace
from typing import Any

from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.shape.cross_section import (
    CrossSectionParameters,
    expected_position,
    find_again,
    find_first,
)
from sonoservo.systems.signals.cross_section import CrossSection, CrossSectionTrack
from sonoservo.systems.signals.image_slice import ImageClick, ImageSlice
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_shape import NeedleShape
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate


class CrossSectionLocalizer(LeafSystem):
    """Localizes a needle's cross-section in a slice, given the earlier ones. It has no state.

    .. pydrake_system::

        name: CrossSectionLocalizer
        input_ports:
        - slice
        - cross_section_track
        - shape (optional)
        - click (optional)
        output_ports:
        - cross_section

    ``slice`` is an `ImageSlice`, or a `NotFound` while there is none. ``cross_section_track`` is a
    `CrossSectionTrack`. ``shape`` is a `NeedleShape` or a `NotFound`. ``cross_section`` is the
    `CrossSection` in the newest slice, or a `NotFound` with the reason why there is none.

    ``click`` is an `ImageClick` on the needle in a slice, or a `NotFound` before it. If the port is
    connected, the first cross-section is searched for near the click, and not before it.

    While the needle is not found, its last template is kept, and the region of interest follows
    the predicted shape.

    Parameters
    ----------
    parameters
        Settings of the search.
    """

    def __init__(self, *, parameters: CrossSectionParameters) -> None:
        super().__init__()
        self.set_name("cross_section_localizer")
        self._parameters = parameters
        declare_inputs(
            self,
            slice=(ImageSlice, NotFound),
            cross_section_track=CrossSectionTrack,
            shape=(NeedleShape, NotFound),
            click=(ImageClick, NotFound),
        )
        declare_output(
            self,
            "cross_section",
            (CrossSection, NotFound),
            self._calc_cross_section,
            {self.all_input_ports_ticket()},
        )

    def _calc_cross_section(self, context: Context, output: Value) -> None:
        track = evaluate(self, context, "cross_section_track", CrossSectionTrack)
        image = evaluate(self, context, "slice", (ImageSlice, NotFound))
        # A slice is never searched twice: the second time its own template would be compared.
        if not isinstance(image, ImageSlice) or image.time <= track.time:
            output.set_value(track.found)
        elif track.last is None:
            output.set_value(self._find_first(context, (*track.images, image)))
        else:
            shape: Any = NotFound("no shape")
            if self.GetInputPort("shape").HasValue(context):
                shape = evaluate(self, context, "shape", (NeedleShape, NotFound))
            expected = expected_position(image, track.last, shape, self._parameters)
            output.set_value(find_again(image, track.last, expected, self._parameters))

    def _find_first(
        self, context: Context, images: tuple[ImageSlice, ...]
    ) -> CrossSection | NotFound:
        if not self.GetInputPort("click").HasValue(context):
            return find_first(images, self._parameters)
        click = evaluate(self, context, "click", (ImageClick, NotFound))
        if not isinstance(click, ImageClick):
            return NotFound("nobody has clicked on the needle yet")
        return find_first(images, replace(self._parameters, start=click.position.tolist()))
