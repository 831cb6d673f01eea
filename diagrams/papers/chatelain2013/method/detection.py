"""Detection of an insertion as published, with nothing added to it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.sampling.kernels import chosen_ties
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.requirements import Bounded, Positive
from sonoservo.systems.signals.volume import Volume

_ALL = np.ones((1, 1, 1), bool)


@dataclass(kw_only=True)
class PublishedDetectionParameters(Bounded):
    """Thresholds of Chatelain 2013, section II-B. The paper publishes no values.

    Parameters
    ----------
    candidate_volume
        Total volume of the candidate voxels, which fixes their number ``|X|``, in m^3. The paper
        chooses the number that best separates the variance of a motionless volume from that of a
        volume with a moving needle. So it was here, with figs. 4 and 5 on seeds from 100 on.
    max_std
        Square root of the variance threshold tau, in m. The variance is the trace of the
        candidates' covariance. Between sweeps of one direction, half the volumes with a moving
        needle are below 24 mm, and no motionless one is below 34 mm.
    max_depth
        Largest distance delta from the geometric median to the candidate entry point, in m. The
        field of view is 20 to 40 mm thick, so a larger one takes any tip for an entry.
    same_direction
        Whether consecutive sweeps of one direction are compared, or any. To and fro, they differ by
        more than a needle of 2.5 mm/s changes between them.
    """

    candidate_volume: Positive = 5e-9
    max_std: Positive = 27e-3
    max_depth: Positive = 7e-3
    same_direction: bool = True


def detect_as_published(
    volume: Volume,
    previous: Volume,
    parameters: PublishedDetectionParameters,
) -> InsertionDetection | NotFound:
    """Detect an insertion as Chatelain 2013, section II-B describes it, or say why there is none.

    The voxels whose difference is at least T_t (eq. 1) must have a variance below tau. Their
    geometric median (eq. 2), projected on the closest face, is an entry if it is closer than delta.
    """
    # The tip of the detection is the median, as the paper does not estimate one. Its difference
    # holds for a static probe only, whereas ours lands on the phantom first; volumes between which
    # the probe moved by more than a voxel are therefore not compared.
    if volume.intensities.shape != previous.intensities.shape:
        return NotFound("the previous volume lies on another grid")
    if _moved(volume, previous) > float(volume.spacing.max()):
        return NotFound("the probe moved between the volumes")
    count = max(4, round(parameters.candidate_volume / float(np.prod(volume.spacing))))
    # Sweeps to and fro see slightly unlike sectors; only voxels that both show are compared.
    seen = volume.seen, previous.seen
    index, threshold = top_differences(volume.intensities, previous.intensities, count, seen=seen)
    if len(index) < 4:
        return NotFound("nothing changed")
    p_P = volume.position(index)
    std = float(np.sqrt(p_P.var(axis=0).sum()))
    if std > parameters.max_std:
        return NotFound(f"the change is spread over {1e3 * std:.1f} mm")
    median = geometric_median(p_P)
    entry = closest_face(volume, median)
    depth = float(np.linalg.norm(entry - median))
    if depth > parameters.max_depth:
        return NotFound(f"the change lies {1e3 * depth:.1f} mm inside the field of view")
    p_W, _ = volume.at_once().to_world(np.stack([entry, median]))
    change = threshold * volume.decibels_per_level
    return InsertionDetection(p_W[0], p_W[1], p_W[1], std, change, volume.time)


def _moved(volume: Volume, previous: Volume) -> float:
    """Return the farthest that a corner of the volume's grid moved with the probe, in m."""
    corners = np.stack(np.meshgrid(*zip(volume.origin, volume.upper, strict=True)), axis=-1)
    p_P = corners.reshape(-1, 3).T
    apart = volume.X_WP.multiply(p_P) - previous.X_WP.multiply(p_P)
    return float(np.linalg.norm(apart, axis=0).max())


@njit(cache=True, nogil=True)
def _changes(  # pragma: no cover - compiled
    a: Any, b: Any, seen_a: Any, seen_b: Any, both: bool
) -> Any:
    """Find the voxels that differ, and by how much."""
    nx, ny, nz = a.shape
    capacity = 65536
    index = np.empty(capacity, np.int64)
    change = np.empty(capacity, np.float32)
    found = 0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                x, y = float(a[i, j, k]), float(b[i, j, k])
                if x == y or (both and not (seen_a[i, j, k] and seen_b[i, j, k])):
                    continue
                if found == capacity:
                    capacity *= 2
                    index = np.concatenate((index, np.empty_like(index)))
                    change = np.concatenate((change, np.empty_like(change)))
                index[found] = (i * ny + j) * nz + k
                change[found] = abs(x - y)
                found += 1
    return index[:found], change[:found]


def top_differences(
    current: NDArray[Any],
    previous: NDArray[Any],
    count: int,
    *,
    seen: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None = None,
) -> tuple[NDArray[np.int64], float]:
    """Return (m, 3) indices and least change of the ``count`` voxels that differ most (eq. 1)."""
    seen_now, seen_before = seen or (_ALL, _ALL)
    index, change = _changes(current, previous, seen_now, seen_before, seen is not None)
    if len(index) == 0:
        return np.empty((0, 3), np.int64), 0.0
    if len(index) > count:
        threshold = np.partition(change, -count)[-count]
        above = index[change > threshold]
        ties = chosen_ties(index[change == threshold], count - len(above))
        index = np.concatenate([above, ties])
    else:
        threshold = change.min()
    return np.stack(np.unravel_index(index, current.shape), axis=1), float(threshold)


def geometric_median(
    points: ArrayLike, *, tolerance: float = 1e-7, max_trials: int = 200
) -> NDArray[np.float64]:
    """Return the (d,) geometric median of (m, d) points (Chatelain 2013, eq. 2)."""
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or len(points) == 0:
        raise ValueError(f"points has shape {points.shape}; expected (m, d) with m > 0")
    median = points.mean(axis=0)
    for _ in range(max_trials):
        distance = np.linalg.norm(points - median, axis=1)
        apart = distance > tolerance
        if not apart.any():
            return median
        weights = 1 / distance[apart]
        target = weights @ points[apart] / weights.sum()
        here = len(points) - np.count_nonzero(apart)
        if here:
            pull = float(np.linalg.norm(weights @ (points[apart] - median)))
            target = median + max(0.0, 1 - here / max(pull, 1e-300)) * (target - median)
        step = float(np.linalg.norm(target - median))
        median = target
        if step < tolerance:
            break
    return median


def closest_face(volume: Volume, p_P: NDArray[np.float64]) -> NDArray[np.float64]:
    """Project a position, (3,) in P, in m, on the closest of the six faces of the field of view."""
    faces = _faces(volume, p_P)
    return np.asarray(faces[np.argmin(np.linalg.norm(faces - p_P, axis=1))])


def _faces(volume: Volume, p_P: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (6, 3) projections: on two lateral and two elevation sides, the probe and the end."""
    if volume.motion is None:
        return _ends_of_what_is_seen(volume, p_P)
    geometry, direction = volume.motion.geometry, volume.motion.direction
    k, j, i = (float(x) for x in geometry.index(p_P, direction))
    frames, lines, samples = (n - 1 for n in geometry.shape)
    return geometry.position(
        [k, k, 0, frames, k, k], [0, lines, j, j, j, j], [i, i, i, i, 0, samples], direction
    )


def _ends_of_what_is_seen(volume: Volume, p_P: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (6, 3) positions in P to either side along X, Z and Y at which the seen part ends."""
    last = np.array(volume.intensities.shape) - 1
    at = np.clip(np.rint((p_P - volume.origin) / volume.spacing), 0, last).astype(int)
    ends = np.repeat(p_P[np.newaxis], 6, axis=0)
    for row, axis in ((0, 0), (2, 2), (4, 1)):
        line = [slice(int(i), int(i) + 1) for i in at]
        line[axis] = slice(None)
        seen = np.flatnonzero(volume.seen[tuple(line)])
        outermost = seen[[0, -1]] if len(seen) else np.array([0, last[axis]])
        ends[row : row + 2, axis] = volume.origin[axis] + volume.spacing[axis] * outermost
    return ends
