"""The leaf that shows a shape prediction on screens: in the world, on the console, or both."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.leaves import declare_looks
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_shape import NeedleShape
from sonoservo.systems.signals.ports import declare_inputs, evaluate


@dataclass(frozen=True, eq=False)
class ShapeSight:
    """What a screen is given at a time in s: values of the ports of `ShapeView`."""

    time: float
    needle: Needle
    X_WT: RigidTransform
    image: ImageSlice | NotFound
    found: CrossSection | NotFound
    shape: NeedleShape | NotFound


class ShapeScreen(Protocol):
    """Screen of a shape prediction: `ShapeWorld` or `ShapePage`."""

    def start(self) -> None:
        """Begin a new run."""
        ...

    def show(self, seen: ShapeSight) -> None:
        """Show what is there now."""
        ...


class ShapeView(LeafSystem):
    """Shows a needle, its predicted shape, and the newest slice with the cross-section in it.

    .. pydrake_system::

        name: ShapeView
        input_ports:
        - needle
        - X_WT
        - slice
        - cross_section
        - shape

    ``needle`` is the true `Needle` in T, for display only. The last three are values of a shape
    predictor, or a `NotFound`.
    The looks come with a period and an offset in s: shortly after the estimator's events.
    """

    def __init__(
        self, *, screens: Sequence[ShapeScreen], period: float, offset: float = 0.0
    ) -> None:
        super().__init__()
        self._screens = tuple(screens)
        declare_inputs(
            self,
            X_WT=RigidTransform,
            needle=Needle,
            slice=(ImageSlice, NotFound),
            cross_section=(CrossSection, NotFound),
            shape=(NeedleShape, NotFound),
        )
        self._start()
        declare_looks(self, self._publish, period=period, offset=offset, start=self._start)

    def _start(self, context: Context | None = None) -> None:
        for screen in self._screens:
            screen.start()

    def _publish(self, context: Context) -> None:
        seen = ShapeSight(
            context.get_time(),
            evaluate(self, context, "needle", Needle),
            evaluate(self, context, "X_WT", RigidTransform),
            evaluate(self, context, "slice", (ImageSlice, NotFound)),
            evaluate(self, context, "cross_section", (CrossSection, NotFound)),
            evaluate(self, context, "shape", (NeedleShape, NotFound)),
        )
        for screen in self._screens:
            screen.show(seen)
