"""What is sent over a live connection, as messages, and the feeds of a `Sender` that make them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.live.acquisition import acquisition_item
from sonoservo.systems.live.connection.items import (
    CovarianceItem,
    CurveItem,
    ImageItem,
    Item,
    PointsItem,
    PoseItem,
    StatusItem,
)
from sonoservo.systems.live.image_matcher import DEFAULT_POSES
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.planes import sample_plane, slice_planes
from sonoservo.systems.signals.ports import Types
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.sweep import Sweep
from sonoservo.systems.signals.volume import Volume

IMAGE = "Image_Probe"
"""In 3D Slicer and PLUS, an image whose coordinates are those of the probe."""

SLICES = ("SliceA_Probe", "SliceB_Probe")
"""Device names: the slice across the beam that contains the needle's depth, and the other one."""

FRAME = "Frame"

TIP, NEEDLE, TISSUE = "TrueTipToReference", "TrueNeedle", "TrueTissueToRef"
"""Device names of the truth; trackers take none that begins with True."""

_TIP_LENGTH = 1e-3  # Length in m over which the direction at the true tip is taken
_KEEP = 2  # Number of large values that wait for a slow receiver; it gets the newest
_POINTS = 21


@dataclass(frozen=True, kw_only=True)
class NeedleNames:
    """Device names of what is told about a needle; 1 to 20 bytes long, empty leaves it out.

    `tip`: TRANSFORM with its origin at the tip and Z along the needle; `curve`: POLYDATA with a
    line, or POINT with control points if ``points``; `status`: STATUS with mode and reason;
    `covariance`: NDARRAY with that of the tip.
    """

    tip: str = "NeedleTipToReference"
    curve: str = "Needle"
    status: str = "NeedleStatus"
    covariance: str = "NeedleTipCovariance"
    points: bool = False

    def __post_init__(self) -> None:
        for field in ("tip", "curve", "status", "covariance"):
            name = getattr(self, field)
            require(len(name.encode()) <= 20, field, name, "at most 20 bytes long")


def tip_pose(curve: NeedleCurve) -> RigidTransform:
    """Return the pose of the tip's frame: origin at the tip, Z along the needle there."""
    return RigidTransform(RotationMatrix.MakeFromOneVector(curve.tangent(1.0), 2), curve.tip)


def curve_points(curve: NeedleCurve) -> NDArray[np.float64]:
    """Return (m, 3) points along a needle that look like it, in m."""
    return curve.position(np.linspace(0, 1, 2 if curve.order == 2 else _POINTS))


def needle_items(estimate: NeedleEstimate, names: NeedleNames, time: float) -> list[Item]:
    """Return an estimate in W as messages with its image's stamp in s; its status alone if lost."""
    good = estimate.mode is TrackingMode.TRACKING
    text = f"{estimate.mode}: {estimate.reason}" if estimate.reason else str(estimate.mode)
    items: list[Item] = [StatusItem(names.status, time, good, text)]
    if estimate.curve is not None:
        curve = estimate.curve
        shape = (
            PointsItem(names.curve, time, curve.control_points)
            if names.points
            else CurveItem(names.curve, time, curve_points(curve))
        )
        items += [
            PoseItem(names.tip, time, tip_pose(curve)),
            shape,
            CovarianceItem(names.covariance, time, estimate.tip_covariance),
        ]
    return [item for item in items if item.name]


def volume_items(
    volume: Volume, name: str = IMAGE, settings: Mapping[str, Any] | None = None
) -> list[Item]:
    """Return how a volume was acquired, the probe's pose, and the image: a voxel in L as in P."""
    X_LI = np.eye(4)
    X_LI[:3] = np.column_stack([np.diag(volume.spacing), volume.origin])
    return [
        acquisition_item(volume, settings or {}),
        PoseItem(DEFAULT_POSES, volume.time, volume.X_WP),
        ImageItem(name, volume.time, volume.intensities, X_LI),
    ]


def slice_items(volume: Volume, curve: NeedleCurve | None = None) -> list[Item]:
    """Return the two orthogonal slices in P through a needle in W, or else Z = 0 and X = 0."""
    items: list[Item] = []
    spacing = float(volume.spacing.min())
    for name, plane in zip(SLICES, slice_planes(volume, curve), strict=False):
        grey = sample_plane(volume, plane, spacing)
        rows, columns = grey.shape
        R = plane.X_PS.rotation().matrix()
        X_LI = np.eye(4)
        steps = [plane.width / columns, plane.height / rows, spacing]
        X_LI[:3] = np.column_stack([R * steps, plane.grid(rows, columns)[0, 0]])
        items.append(ImageItem(name, volume.time, grey.T[..., np.newaxis], X_LI))
    return items


def frame_items(sweep: Sweep, name: str = FRAME) -> list[Item]:
    """Return a sweep's frames in order of time, as images of one layer, each after its pose."""
    X_LI = np.diag([sweep.geometry.sample_pitch, 1e-3, 1e-3, 1.0])
    items: list[Item] = []
    for number in np.argsort(sweep.motion.times):
        time = float(sweep.motion.times[number])
        X_WP = RigidTransform(sweep.motion.X_WP[number])
        items.append(PoseItem(DEFAULT_POSES, time, X_WP))
        items.append(ImageItem(name, time, sweep.samples[number].T[..., np.newaxis], X_LI))
    return items


def truth_items(needle: Needle, X_WT: RigidTransform, time: float) -> list[Item]:
    """Return the truth as messages: the needle in T and the pose of T, at a time in s."""
    items: list[Item] = [PoseItem(TISSUE, time, RigidTransform(X_WT))]
    if needle:
        moved = needle.transformed(X_WT)
        along = moved.tip - moved.position(moved.length - min(_TIP_LENGTH, moved.length))
        items.append(CurveItem(NEEDLE, time, moved.shaft))
        if along.any():
            X_WTip = RigidTransform(RotationMatrix.MakeFromOneVector(along, 2), moved.tip)
            items.append(PoseItem(TIP, time, X_WTip))
    return items


@dataclass(frozen=True, kw_only=True)
class Feed:
    """Inputs of a `Sender` with their types, and how their values become messages.

    `items` makes the messages of the time in s and the values by name. `stamp` returns the values'
    time in s, of which each is sent once, or None if there is nothing to send; without it, whatever
    the inputs hold is sent each time. See `Link.send` for topic and keep.
    """

    inputs: Mapping[str, Types]
    items: Callable[..., list[Item]]
    stamp: Callable[..., float | None] | None = None
    topic: str = ""
    keep: int | None = None


def _time_of(volume: Volume | NotFound, **others: Any) -> float | None:
    return volume.time if isinstance(volume, Volume) else None


def volume_feed(
    name: str = IMAGE, settings: Mapping[str, Any] | None = None, *, posed: bool = True
) -> Feed:
    """Return the feed of each new volume; settings are for receivers of our own.

    `posed` sends the probe's pose with it, for want of a `pose_feed`, which would be ahead of it.
    """
    return Feed(
        inputs={"volume": (Volume, NotFound)},
        stamp=_time_of,
        items=lambda time, volume: _posed(volume_items(volume, name, settings), posed),
        topic="volume",
        keep=_KEEP,
    )


def _posed(items: list[Item], posed: bool) -> list[Item]:
    """Return messages, without those of poses unless they are wanted."""
    return items if posed else [each for each in items if not isinstance(each, PoseItem)]


def needle_feed(names: NeedleNames | None = None) -> Feed:
    """Return the feed of each new estimate in W, with the time of its volume."""
    devices = names or NeedleNames()
    return Feed(
        inputs={"estimate": NeedleEstimate},
        stamp=lambda estimate: estimate.volume_time,
        items=lambda time, estimate: needle_items(estimate, devices, estimate.volume_time),
        topic="estimate",
    )


def slice_feed() -> Feed:
    """Return the feed of the two slices through each new volume with the estimated needle."""
    return Feed(
        inputs={"volume": (Volume, NotFound), "estimate": NeedleEstimate},
        stamp=_time_of,
        items=lambda time, volume, estimate: slice_items(volume, estimate.curve),
        topic="slices",
        keep=_KEEP,
    )


def sweep_feed(name: str = FRAME, *, posed: bool = True) -> Feed:
    """Return the feed of the frames of each new sweep at their own times; see `volume_feed`."""
    return Feed(
        inputs={"sweep": (Sweep, NotFound)},
        stamp=lambda sweep: sweep.motion.time if isinstance(sweep, Sweep) else None,
        items=lambda time, sweep: _posed(frame_items(sweep, name), posed),
        topic="frames",
        keep=_KEEP,
    )


def pose_feed(name: str) -> Feed:
    """Return the feed of the probe's pose, at a fixed rate; copied, as inputs change in place."""
    return Feed(
        inputs={"X_WP": RigidTransform},
        items=lambda time, X_WP: [PoseItem(name, time, RigidTransform(X_WP))],
    )


def truth_feed() -> Feed:
    """Return the feed of what only a simulation knows, under names that say so."""
    return Feed(
        inputs={"needle": Needle, "X_WT": RigidTransform},
        items=lambda time, needle, X_WT: truth_items(needle, X_WT, time),
        topic="truth",
    )
