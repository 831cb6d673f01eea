"""Screen of a shape prediction on a console: slices and the needle's deflection."""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.display.console.readings import Frame, Reading, Sample
from sonoservo.systems.display.console.slices import SlicePicture
from sonoservo.systems.display.shape_view import ShapeSight
from sonoservo.systems.signals.confidence import RADIUS_95
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.needle_shape import NeedleShape

if TYPE_CHECKING:  # a run without a page does not import it
    from sonoservo.systems.display.console.console import Console

Floats = NDArray[np.float64]

_POINTS = 41
# Marks of the world, by the class of their colour in the page, and their words.
_LEGEND = ("truth needle", "tracking predicted", "band 95 % of it", "cross-section found here")
PATHS = ("depth", "x", "x_low", "x_high", "y", "y_low", "y_high")
"""Columns of the predicted path: depth, and the mean and 95 % of the deflection along X and Y."""


class ShapePage:
    """Shows each slice with the cross-section in it, and the deflection over depth, on a console.

    The deflection is that from the first cross-section, along X and along Y of the probe at the
    first slice: what was predicted with its 95 % down to a depth in m, and what was found in each
    slice beside where the true needle crossed it, which moves on with the tissue afterwards.
    """

    def __init__(self, *, console: "Console", depth: float) -> None:
        self._console = console
        self._depths = np.linspace(0, depth, _POINTS)

    def start(self) -> None:
        """Forget an earlier run."""
        self._console.say(
            without=["second", "planes", "features", "angle", "force", "probability", "mode"],
            legend=_LEGEND,
        )
        self._first: RigidTransform | None = None
        self._origin: Floats | None = None
        self._found: list[list[float]] = []
        self._true: list[list[float]] = []
        self._number = 0
        self._time = -math.inf

    def show(self, seen: ShapeSight) -> None:
        """Show the slice, if it is new."""
        image, found, shape = seen.image, seen.found, seen.shape
        if not isinstance(image, ImageSlice) or image.time <= self._time:
            return
        self._time, self._number = image.time, self._number + 1
        self._first = self._first or image.X_WP
        into_first = self._first.inverse()
        shaft = into_first.multiply(seen.X_WT.multiply(seen.needle.shaft.T)).T.reshape(-1, 3)
        depth = float(into_first.multiply(image.X_WP.translation())[2])
        if len(shaft) and shaft[0, 2] <= depth <= shaft[-1, 2]:
            self._true.append([*_crossing(shaft, depth), depth])
        if isinstance(found, CrossSection):
            place = into_first.multiply(found.position)
            if self._origin is None:
                self._origin = place[:2]
            self._found.append(place.tolist())
        if self._origin is None:
            self._origin = shaft[0, :2] if len(shaft) else np.zeros(2)
        picture = slice_picture(image, found)
        paths = self._paths(shape)
        mode = TrackingMode.TRACKING if isinstance(found, CrossSection) else TrackingMode.LOST
        self._console.show_frame(
            Frame(self._number, image.time, mode, [picture], image.decibels_per_level, paths)
        )
        self._console.add(self._sample(seen.time, depth, found, shape, shaft))

    def _paths(self, shape: NeedleShape | NotFound) -> dict[str, list[float]]:
        """Return columns in mm: the predicted path, those found, and the true ones; see `PATHS`."""
        columns: dict[str, list[float]] = {name: [] for name in PATHS}
        assert self._origin is not None
        if isinstance(shape, NeedleShape):
            mean, covariance = shape.predict(self._depths)
            columns["depth"] = (1e3 * self._depths).tolist()
            for axis, name in enumerate("xy"):
                middle = 1e3 * (mean[:, axis] - self._origin[axis])
                # 95 % of a normal distribution along one axis.
                reach = 1.96e3 * np.sqrt(covariance[:, axis, axis])
                for column, values in (("", middle), ("_low", middle - reach),
                                       ("_high", middle + reach)):  # fmt: skip
                    columns[name + column] = np.round(values, 3).tolist()
        for prefix, crossed in (("found", self._found), ("true", self._true)):
            points = np.reshape(crossed, (-1, 3))
            inside = points[points[:, 2] >= 0]
            shown = 1e3 * (inside - [*self._origin, 0.0])
            for name, values in zip(("x", "y", "depth"), shown.T, strict=True):
                columns[f"{prefix}_{name}"] = np.round(values, 3).tolist()
        return columns

    def _sample(
        self,
        time: float,
        depth: float,
        found: CrossSection | NotFound,
        shape: NeedleShape | NotFound,
        shaft: Floats,
    ) -> Sample:
        assert self._first is not None
        assert self._origin is not None
        bend, final, sure, error = (math.nan,) * 4
        if len(shaft):
            bend = 1e3 * float(np.linalg.norm(shaft[-1, :2] - self._origin))
        if isinstance(shape, NeedleShape):
            mean, _ = shape.predict(self._depths[-1:])
            final = 1e3 * float(np.linalg.norm(mean[0] - self._origin))
            sure = 1e3 * RADIUS_95 * float(shape.std(self._depths[-1:])[0])
        if isinstance(found, CrossSection) and len(shaft):
            place = self._first.inverse().multiply(found.position)
            error = 1e3 * float(np.linalg.norm(place[:2] - _crossing(shaft, depth)))
        end = f"bend at {1e3 * self._depths[-1]:.0f}"
        readings = [
            Reading("depth", "slice at", 1e3 * depth, "mm"),
            Reading("error", "section off", error, "mm", 2),
            Reading("bend", "true bend", bend, "mm"),
            Reading("final", end, final, "mm"),
            Reading("sure", "95 % within", sure, "mm", 2),
        ]
        said = "following the needle" if isinstance(found, CrossSection) else found.reason
        return Sample(time=time, error=error, readings=readings, reason=said)


def _crossing(shaft: Floats, depth: float) -> Floats:
    """Return x and y at a depth of a needle's (n, 3) points, entry first."""
    return np.array([np.interp(depth, shaft[:, 2], axis) for axis in shaft[:, :2].T])


def slice_picture(image: ImageSlice, found: CrossSection | NotFound) -> SlicePicture:
    """Return the picture of an axial slice, with a ring around the cross-section found in it."""
    size = 1e3 * image.spacing * image.intensities.shape
    left, top = 1e3 * (image.position([0, 0]) - 0.5 * image.spacing)
    window = float(left), float(left + size[0]), float(top), float(top + size[1])
    centre = 1e3 * found.centre if isinstance(found, CrossSection) else np.zeros(0)
    return SlicePicture(
        "Axial slice, with the cross-section found in it", ("X", "depth"),
        np.ascontiguousarray(image.intensities.T), (float(left), float(top)),
        (float(size[0]), float(size[1])), window, [], centre,
    )  # fmt: skip
