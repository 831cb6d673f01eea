"""The two slices through the needle, with coordinates in mm and an overlay beside the echo."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.signals.line_hypotheses import LINE_CLASSES, LineHypotheses
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.planes import Plane, sample_plane, slice_planes
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

_PIXEL = 0.4e-3  # Pixel size of the pictures, in m
_BESIDE = 2.5e-3  # Distance of the overlay from the needle's axis, in m: clear of the echo
_POINTS = 21
# Largest distance of a slice from the needle at which the overlay belongs to it, in m.
_IN_PLANE = 1.5e-3
_NEARBY = 3e-3  # Largest distance in m from a slice at which a followed line is drawn in it
# Titles and axes of the two slices, without and with a needle.
_NAMES = (
    (("Lateral plane", ("X", "depth")), ("Elevation plane", ("Z", "depth"))),
    (
        ("Along needle and beam", ("along needle", "depth")),
        ("Along needle, across beam", ("along needle", "across beam")),
    ),
)


@dataclass(frozen=True)
class SliceView:
    """A slice as it appears on a screen, with coordinates to the right and down.

    `plane` is the visible part in P, `origin` that of the coordinates in P, and `window` the upper
    left and lower right corners of the area shown, all in m.
    """

    plane: Plane
    origin: Floats
    window: Floats

    def coordinates(self, p_P: Floats) -> Floats:
        """Return the (..., 2) coordinates in m of (..., 3) points in P, in m."""
        return (np.asarray(p_P) - self.origin) @ self.plane.X_PS.rotation().matrix()[:, :2]


@dataclass(frozen=True, eq=False)
class SlicePicture:
    """A slice to be drawn, with its title and the names of its coordinates to the right and down.

    In mm: upper left corner and size of the (rows, columns) levels; left, right, top and bottom
    edges of the area shown; two polylines beside the needle; its (2,) tip, empty without one; and
    class and (2, 2) ends of the lines that are followed near the slice.
    """

    title: str
    axes: tuple[str, str]
    grey: NDArray[np.uint8]
    corner: tuple[float, float]
    size: tuple[float, float]
    window: tuple[float, float, float, float]
    rails: list[Floats]
    tip: Floats
    lines: Sequence[tuple[str, Floats]] = ()


def slice_views(
    volume: Volume, curve: NeedleCurve | None = None, offsets: tuple[float, float] = (0.0, 0.0)
) -> list[SliceView | None]:
    """Return the views of the two orthogonal planes through the needle, or the probe.

    X or else Z of P runs right, and the depth or else Z down. Along a needle that dips, zero is the
    point below the middle of the probe. Both windows depend on the size of the volume alone.
    `offsets` are distances along the normals, in m; a slice that misses the volume is None.
    """
    size = volume.upper - volume.origin
    middle = 0.5 * (volume.upper + volume.origin)
    half = 0.5 * np.array([np.hypot(size[0], size[2]), max(size[1], size[2])])
    views: list[SliceView | None] = []
    for slice_, offset in zip(slice_planes(volume, curve), offsets, strict=False):
        R = _upright(slice_)
        centre = slice_.X_PS.translation() + offset * R[:, 2]
        scale = _level_scale(R)
        origin = _origin(R, centre)
        place = np.array([scale @ middle, R[:, 1] @ middle])
        at = (centre - origin) @ R[:, :2]
        held = 0.5 * np.array([slice_.width, slice_.height])
        low, high = np.maximum(at - held, place - half), np.minimum(at + held, place + half)
        inside = volume.origin - 1e-9 <= centre, centre <= volume.upper + 1e-9
        if not (low < high).all() or (offset and not np.all(inside)):
            views.append(None)
        else:
            p_P = centre + R[:, :2] @ (0.5 * (low + high) - at)
            plane = Plane(RigidTransform(RotationMatrix(R), p_P), *(high - low))
            views.append(SliceView(plane, origin, np.stack([place - half, place + half])))
    return views


def _upright(slice_: Plane) -> Floats:
    """Return the axes of a slice in P, turned so that X or else Z of P runs to the right."""
    R = slice_.X_PS.rotation().matrix()
    right = 1.0 if R[0, 0] + 1e-6 * R[2, 0] >= 0 else -1.0
    down = 1.0 if R[1, 1] + R[2, 1] >= 0 else -1.0
    return R * [right, down, right * down]


def _origin(R: Floats, centre: Floats) -> Floats:
    """Return the origin in P, in m, of a slice's coordinates; see `slice_views`."""
    return R[:, 0] * (R[:, 0] @ centre - _level_scale(R) @ centre)


def _level_scale(R: Floats) -> Floats:
    """Return the vector in P that is zero below the middle of the probe, and 1 a metre along X."""
    level = R[:, 0] * [1, 0, 1]
    return level / (level @ level) if level @ level > 0.25 else np.zeros(3)


def kept_slice(number: int, slice_: Plane, grey: NDArray[np.uint8], needle: Floats) -> SlicePicture:
    """Return the picture of a slice that was sampled earlier, along its own X and Y."""
    R, centre = _upright(slice_), slice_.X_PS.translation()
    plane = Plane(RigidTransform(RotationMatrix(R), centre), slice_.width, slice_.height)
    view = SliceView(plane, _origin(R, centre), np.zeros((2, 2)))
    half = 0.5 * np.array([slice_.width, slice_.height])
    window = view.coordinates(centre) + np.stack([-half, half])
    turned = np.sum(R * slice_.X_PS.rotation().matrix(), axis=0)[:2] < 0
    grey = grey[:: -1 if turned[1] else 1, :: -1 if turned[0] else 1]
    shown = view.coordinates(needle) if len(needle) else None
    names = _NAMES[len(needle) > 0][number]
    return _picture(replace(view, window=window), np.ascontiguousarray(grey), names, shown)


def slice_pictures(
    volume: Volume,
    curve: NeedleCurve | None = None,
    offsets: tuple[float, float] = (0.0, 0.0),
    lines: LineHypotheses | None = None,
) -> list[SlicePicture | None]:
    """Return the pictures of the two orthogonal planes through the needle; see `slice_views`."""
    pictures: list[SlicePicture | None] = []
    views = slice_views(volume, curve, offsets)
    for view, names, offset in zip(views, _NAMES[curve is not None], offsets, strict=False):
        if view is None:
            pictures.append(None)
            continue
        grey = sample_plane(volume, view.plane, max(_PIXEL, 0.5 * float(volume.spacing.min())))
        needle = None
        if curve is not None and abs(offset) <= _IN_PLANE:
            points = volume.to_probe(curve.position(np.linspace(0, 1, _POINTS)))
            needle = view.coordinates(points)
        near = lines_near(view, volume, lines) if lines else ()
        pictures.append(_picture(view, grey, names, needle, near))
    return pictures


def _picture(
    view: SliceView,
    grey: NDArray[np.uint8],
    names: tuple[str, tuple[str, str]],
    needle: Floats | None,
    lines: Sequence[tuple[str, Floats]] = (),
) -> SlicePicture:
    """Return a view as a picture with its title and axes, and an (m, 2) needle in m, if any."""
    size = np.array([view.plane.width, view.plane.height])
    x, y = 1e3 * (view.coordinates(view.plane.X_PS.translation()) - 0.5 * size)
    (left, top), (right, bottom) = 1e3 * view.window
    rails, tip = [], np.zeros(0)
    if needle is not None:
        rails, tip = beside(1e3 * needle, 1e3 * _BESIDE), 1e3 * needle[-1]
    window = float(left), float(right), float(top), float(bottom)
    extent = 1e3 * float(size[0]), 1e3 * float(size[1])
    return SlicePicture(*names, grey, (float(x), float(y)), extent, window, rails, tip, lines)


def line_classes(lines: LineHypotheses) -> list[str]:
    """Return the most probable class of each line; see `LINE_CLASSES`."""
    return [LINE_CLASSES[number] for number in lines.classes.argmax(axis=1)]


def lines_near(view: SliceView, volume: Volume, lines: LineHypotheses) -> list[tuple[str, Floats]]:
    """Return class and (2, 2) ends in mm of the parts of lines within 3 mm of a slice."""
    ends = volume.to_probe(lines.ends.reshape(-1, 3)).reshape(-1, 2, 3)
    R, middle = view.plane.X_PS.rotation().matrix(), view.plane.X_PS.translation()
    near: list[tuple[str, Floats]] = []
    for name, line in zip(line_classes(lines), ends, strict=True):
        first, last = (line - middle) @ R[:, 2]
        slope = last - first or 1e-12
        low, high = sorted((side - first) / slope for side in (-_NEARBY, _NEARBY))
        low, high = max(low, 0.0), min(high, 1.0)
        if name != "nothing" and low < high:
            part = line[0] + np.outer([low, high], line[1] - line[0])
            near.append((name, 1e3 * view.coordinates(part)))
    return near


def beside(polyline: Floats, distance: float) -> list[Floats]:
    """Return the two polylines that run beside an (m, 2) polyline at a distance."""
    along = np.gradient(polyline, axis=0)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = np.divide(along, length, out=np.zeros_like(along), where=length > 0)
    across = distance * np.stack([-along[:, 1], along[:, 0]], axis=1)
    return [polyline - across, polyline + across]
