"""Reconstruction of volumes from posed 2D frames of freehand or motorised sweeps."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.sampling.seen_hull import cut_level, darkest, seen_hull
from sonoservo.systems.signals.immutable import Immutable, seal
from sonoservo.systems.signals.requirements import require, require_positive
from sonoservo.systems.signals.sweep import DECIBELS_PER_LEVEL
from sonoservo.systems.signals.volume import ReconstructedVolume

_MAX_VOXELS = 1 << 26
_SLACK = 1e-9


@dataclass(frozen=True, eq=False)
class PosedFrame(Immutable):
    """A 2D picture, (ni, nj) grey levels with j away from the probe, and its time."""

    pixels: NDArray[np.uint8] | NDArray[np.float32]
    X_WI: NDArray[np.float64]
    """(4, 4) transform from pixels (i, j, 0, 1) to positions in W, in m."""
    time: float

    @property
    def far_end(self) -> NDArray[np.float64]:
        """Middle of the deepest row of pixels, (3,), in W, in m."""
        ni, nj = self.pixels.shape
        return (self.X_WI @ [0.5 * (ni - 1), nj - 1, 0, 1])[:3]

    @property
    def X_WF(self) -> RigidTransform:
        """Pose of frame F: origin at the middle of the first row, X across, Y along depth."""
        across, depth = self.X_WI[:3, 0], self.X_WI[:3, 1]
        x = across / np.linalg.norm(across)
        y = depth - (depth @ x) * x
        y /= np.linalg.norm(y)
        R_WF = RotationMatrix(np.column_stack([x, y, np.cross(x, y)]))
        middle = self.X_WI @ [0.5 * (self.pixels.shape[0] - 1), 0, 0, 1]
        return RigidTransform(R_WF, middle[:3])


class SweepSplitter:
    """Splits the frames of a probe that is swept back and forth into sweeps.

    The distance from the start of a sweep grows until the probe turns back. A sweep is complete
    when the probe has come back by ``hysteresis``, in m, which is also its least length, or after
    ``frames``, if given; it is split at ``max_frames``. Frames of a probe at rest form no sweep.
    """

    def __init__(
        self, *, hysteresis: float = 2e-3, frames: int | None = None, max_frames: int = 512
    ) -> None:
        require_positive(hysteresis=hysteresis)
        require(frames is None or frames >= 2, "frames", frames, "at least 2")
        self._hysteresis, self._count, self._max = hysteresis, frames, max_frames
        self._frames: list[PosedFrame] = []
        self._furthest, self._furthest_at = 0.0, 0

    def add(self, frame: PosedFrame) -> list[PosedFrame]:
        """Add a frame; return the sweep that it completes, or an empty list."""
        frames = self._frames
        frames.append(frame)
        distance = float(np.linalg.norm(frame.far_end - frames[0].far_end))
        if distance > self._furthest:
            self._furthest, self._furthest_at = distance, len(frames) - 1
        if self._count is not None:
            return self._cut(len(frames) - 1) if len(frames) > self._count else []
        if self._furthest < self._hysteresis:
            if len(frames) > 8:  # at rest
                del frames[0]
            return []
        if self._furthest - distance > self._hysteresis:
            return self._cut(self._furthest_at + 1, self._furthest_at)
        return self._cut(len(frames) - 1) if len(frames) > self._max else []

    def rest(self) -> list[PosedFrame]:
        """Return the frames of the incomplete last sweep; empty if they form no sweep."""
        moved = self._furthest >= self._hysteresis or self._count is not None
        return self._frames if moved and len(self._frames) > 1 else []

    def _cut(self, end: int, start: int | None = None) -> list[PosedFrame]:
        """Return the frames before ``end``, and start a new sweep with those from ``start`` on."""
        done, left = self._frames[:end], self._frames[end if start is None else start :]
        self._frames, self._furthest, self._furthest_at = [], 0.0, 0
        for frame in left:
            self.add(frame)
        return done


def reconstruct(
    frames: Sequence[PosedFrame],
    *,
    spacing: float = 7e-4,
    max_gap: float = 3e-3,
    decibels_per_level: float = DECIBELS_PER_LEVEL,
) -> ReconstructedVolume:
    """Reconstruct a volume from the frames of one sweep in order of time; P is the middle one's F.

    A voxel between two frames at most ``max_gap`` m apart is interpolated between its projections
    onto both; several pairs give the mean. It stays a hole if no frame passed it, or only beside
    its sector. Raises ValueError if the frames differ in size or are fewer than two.
    """
    require_positive(spacing=spacing, max_gap=max_gap)
    require(len(frames) >= 2, "frames", len(frames), "at least 2")
    shapes = {frame.pixels.shape for frame in frames}
    require(len(shapes) == 1, "frames", sorted(shapes), "all of one size")
    ni, nj = frames[0].pixels.shape
    middle = frames[len(frames) // 2]
    X_PW = middle.X_WF.inverse().GetAsMatrix4()
    X_PI = np.array([X_PW @ frame.X_WI for frame in frames])
    corners = np.array([[i, j, 0, 1] for i in (0, ni - 1) for j in (0, nj - 1)])
    p_P = (X_PI @ corners.T)[:, :3].transpose(0, 2, 1)
    low, high = p_P.min(axis=(0, 1)), p_P.max(axis=(0, 1))
    # At least two voxels along each axis, even if the frames hardly move.
    shape = np.maximum(np.floor((high - low) / spacing + 1e-6).astype(int) + 1, 2)
    require(
        int(shape.prod()) <= _MAX_VOXELS,
        "spacing",
        spacing,
        f"larger: {' x '.join(map(str, shape))} voxels are too many",
    )
    normals = np.cross(X_PI[:, :3, 0], X_PI[:, :3, 1])
    X_PI[:, :3, 2] = normals / np.linalg.norm(normals, axis=1)[:, np.newaxis]
    inverse = np.linalg.inv(X_PI)  # third row: signed distance from the frame's plane
    total, seen, number = (np.zeros(shape, np.float32) for _ in range(3))
    shown = _sector([frame.pixels for frame in frames])
    # Where dark levels were removed, black is no darker than the darkest that is shown.
    cut = np.float32(cut_level(min(darkest(frame.pixels) for frame in frames), decibels_per_level))
    boxes = (p_P - low) / spacing
    for k in range(len(frames) - 1):
        pair = boxes[k : k + 2].reshape(-1, 3)
        first = np.maximum(np.floor(pair.min(axis=0) - _SLACK), 0).astype(int)
        stop = np.minimum(np.ceil(pair.max(axis=0) + _SLACK).astype(int) + 1, shape)
        _fill_between(
            total, seen, number, first, stop, low, spacing, max_gap,
            frames[k].pixels, frames[k + 1].pixels, shown, cut, inverse[k], inverse[k + 1], k,
        )  # fmt: skip
    holes = seen == 0
    np.divide(total, seen, out=total, where=~holes)
    np.divide(number, seen, out=number, where=~holes)
    number[holes] = np.nan
    grey = total
    if frames[0].pixels.dtype == np.uint8:
        grey = np.rint(total).astype(np.uint8)
    return ReconstructedVolume(
        seal(grey),
        low,
        np.full(3, spacing),
        middle.X_WF,
        middle.time,
        decibels_per_level=decibels_per_level,
        frames=seal(number),
        frame_times=np.array([frame.time for frame in frames]),
        frame_poses=np.array([frame.X_WF.GetAsMatrix4() for frame in frames]),
    )


def _sector(pixels: Sequence[NDArray[Any]]) -> NDArray[np.bool_]:
    """Return (ni, nj) flags of the pixels in the `seen_hull` of all frames of a sweep."""
    brightest = np.maximum.reduce(list(pixels))[..., np.newaxis]
    return seen_hull(np.concatenate([brightest, brightest], axis=-1))[..., 0]


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_between(  # type: ignore[no-untyped-def]
    total,
    seen,
    number,
    first,
    stop,
    low,
    spacing,
    max_gap,
    near,
    far,
    shown,
    cut,
    to_near,
    to_far,
    k,
):
    """Add the interpolated grey levels of two frames to the voxels between them."""
    for a in range(first[0], stop[0]):
        for b in range(first[1], stop[1]):
            for c in range(first[2], stop[2]):
                x, y, z = low[0] + spacing * a, low[1] + spacing * b, low[2] + spacing * c
                d0 = to_near[2, 0] * x + to_near[2, 1] * y + to_near[2, 2] * z + to_near[2, 3]
                d1 = to_far[2, 0] * x + to_far[2, 1] * y + to_far[2, 2] * z + to_far[2, 3]
                if d0 * d1 > 0 or abs(d0) + abs(d1) > max_gap:
                    continue
                part = abs(d0) / max(abs(d0) + abs(d1), 1e-30)
                here = _look_up(near, shown, cut, to_near, x, y, z)
                there = _look_up(far, shown, cut, to_far, x, y, z)
                if here < 0 or there < 0:
                    continue
                total[a, b, c] += (1 - part) * here + part * there
                number[a, b, c] += k + part
                seen[a, b, c] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _look_up(pixels, shown, cut, to_frame, x, y, z):  # type: ignore[no-untyped-def]
    """Return the bilinear grey level at a point's projection onto a frame; -1 if unseen."""
    i = to_frame[0, 0] * x + to_frame[0, 1] * y + to_frame[0, 2] * z + to_frame[0, 3]
    j = to_frame[1, 0] * x + to_frame[1, 1] * y + to_frame[1, 2] * z + to_frame[1, 3]
    ni, nj = pixels.shape
    if not (-1e-6 <= i <= ni - 1 + 1e-6 and -1e-6 <= j <= nj - 1 + 1e-6):
        return -1.0
    if not shown[min(max(int(i + 0.5), 0), ni - 1), min(max(int(j + 0.5), 0), nj - 1)]:
        return -1.0
    i0, j0 = min(max(int(i), 0), ni - 2), min(max(int(j), 0), nj - 2)
    u, v = i - i0, j - j0
    a, b = max(pixels[i0, j0], cut), max(pixels[i0, j0 + 1], cut)
    c, d = max(pixels[i0 + 1, j0], cut), max(pixels[i0 + 1, j0 + 1], cut)
    return (1 - u) * ((1 - v) * a + v * b) + u * ((1 - v) * c + v * d)
