"""Robust fit of a needle's axis to voxels, many of which do not belong to the needle."""

import math
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.requirements import (
    Positive,
    PositiveInt,
    at_least,
    check_bounds,
    require,
)
from sonoservo.systems.signals.search_reason import SearchReason
from sonoservo.systems.tracking.axis_fit import AxisFit, as_fit, assess_axis, least_squares

_BLOCK = 128
"""Number of points after which a count may end early."""


@dataclass(kw_only=True)
class RansacParameters:
    """Parameters of the random sample consensus. The paper publishes none of these values.

    Parameters
    ----------
    residual_threshold
        Largest distance f_0 of an inlier from the axis, in m.
    min_separation
        Smallest distance between neighbouring points of a sample along the axis, in m. Closer ones
        do not determine an axis.
    max_bend
        Largest ratio of sagitta to chord, for a curve of order 3.
    stop_probability
        Probability 1 - epsilon that at least one sample was free of outliers (eq. 21).
    max_trials
        Largest number of draws, rejected ones included.
    refits
        Number of least-squares refits on re-selected inliers. With 0, the winning sample's axis is
        kept unchanged for comparison, and the final refit between the needle's ends is left out
        too.
    draws_factor
        Number of draws as a multiple of what eq. 21 requires; 1 is the paper's. The winning sample
        contains only inliers but is often a poor model. With three times the draws and three
        refits on re-selected inliers, none of 500 trials failed; without them, 27 to 32 % did.
    """

    residual_threshold: Positive = 2e-3
    min_separation: Positive = 2e-3
    max_bend: Positive = 0.1
    stop_probability: Positive = 0.999
    max_trials: PositiveInt = 3000
    refits: Annotated[int, at_least(0)] = 3
    draws_factor: Positive = 3.0

    def __post_init__(self) -> None:
        check_bounds(self)
        require(self.stop_probability < 1, "stop_probability", self.stop_probability, "below 1")


@dataclass(frozen=True, eq=False)
class RansacResult:
    """Result of the random sample consensus."""

    fit: AxisFit
    """Least-squares fit on the inliers, or the winning sample's axis without refits."""
    inliers: NDArray[np.bool_]
    trials: int
    rejected: int
    """Number of samples that were rejected unevaluated."""


@njit(cache=True, nogil=True, error_model="numpy")
def _through(  # pragma: no cover - compiled
    coordinates: Any, sample: Any, separation: float, bend: float, curve: Any
) -> Any:
    """Write the curve C(a) = origin + a k + b a (a - length) through two or three points.

    The two points that are farthest apart are its ends; b is zero for two points. Return whether
    the curve can be a needle, and its length.
    """
    first, last, middle = sample[0], sample[1], sample[0]
    if len(sample) == 3:
        third = sample[2]
        d01 = d02 = d12 = 0.0
        for c in range(3):
            d01 += (coordinates[c, first] - coordinates[c, last]) ** 2
            d02 += (coordinates[c, first] - coordinates[c, third]) ** 2
            d12 += (coordinates[c, last] - coordinates[c, third]) ** 2
        if d01 >= d02 and d01 >= d12:
            middle = third
        elif d02 >= d12:
            middle, last = last, third
        else:
            middle, first = first, third
    length = 0.0
    for c in range(3):
        curve[0, c] = coordinates[c, first]
        curve[1, c] = coordinates[c, last] - coordinates[c, first]
        length += curve[1, c] ** 2
    length = np.sqrt(length)
    if length < separation:
        return False, length
    for c in range(3):
        curve[1, c] /= length
    if len(sample) == 3:
        a = 0.0
        for c in range(3):
            a += (coordinates[c, middle] - curve[0, c]) * curve[1, c]
        if a < separation or a > length - separation:
            return False, length
        bending = 0.0
        for c in range(3):
            across = coordinates[c, middle] - curve[0, c] - a * curve[1, c]
            curve[2, c] = across / (a * (a - length))
            bending += curve[2, c] ** 2
        if np.sqrt(bending) * length > 4 * bend:
            return False, length
    return True, length


@njit(cache=True, nogil=True, error_model="numpy")
def _count_near(  # pragma: no cover - compiled
    coordinates: Any, curve: Any, length: float, limit: float, least: int
) -> Any:
    """Count the points within a squared distance of a curve.

    The count ends early, with a smaller number, once it can no longer exceed ``least``. The points
    are counted in blocks, without branches that stop SIMD.
    """
    x, y, z = coordinates[0], coordinates[1], coordinates[2]
    (ox, oy, oz), (kx, ky, kz), (bx, by, bz) = curve
    bent = bx != 0 or by != 0 or bz != 0
    count = 0
    for start in range(0, len(x), _BLOCK):
        stop = min(start + _BLOCK, len(x))
        for i in range(np.uint64(start), np.uint64(stop)):
            dx, dy, dz = x[i] - ox, y[i] - oy, z[i] - oz
            a = dx * kx + dy * ky + dz * kz
            dx -= a * kx
            dy -= a * ky
            dz -= a * kz
            if bent:
                q = a * (a - length)
                dx -= q * bx
                dy -= q * by
                dz -= q * bz
            count += int(dx * dx + dy * dy + dz * dz < limit)
        if count + len(x) - stop <= least:
            break
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _near(coordinates: Any, axis: Any, limit: float) -> Any:  # pragma: no cover - compiled
    """Flag the points within a squared distance of an axis, as `least_squares` returns it."""
    x, y, z = coordinates[0], coordinates[1], coordinates[2]
    ox, oy, oz = axis[0]
    kx, ky, kz = axis[1]
    c = np.zeros((3, 3))
    for n in range(len(axis) - 2):
        c[n, 0], c[n, 1], c[n, 2] = axis[2 + n]
    near = np.zeros(len(x), np.bool_)
    for i in range(len(x)):
        a = (x[i] - ox) * kx + (y[i] - oy) * ky + (z[i] - oz) * kz
        dx = x[i] - c[0, 0] - a * (c[1, 0] + a * c[2, 0])
        dy = y[i] - c[0, 1] - a * (c[1, 1] + a * c[2, 1])
        dz = z[i] - c[0, 2] - a * (c[1, 2] + a * c[2, 2])
        near[i] = dx * dx + dy * dy + dz * dz < limit
    return near


@njit(cache=True, nogil=True, error_model="numpy")
def _consensus(  # pragma: no cover - compiled
    points: Any,
    weights: Any,
    order: int,
    seed: int,
    expected: Any,
    min_cosine: float,
    distance: float,
    separation: float,
    bend: float,
    log_failure: float,
    draws_factor: float,
    max_draws: int,
    refits: int,
) -> Any:
    """Find the sample whose curve has most points within ``distance``, and refit on those points.

    Return the numbers of draws and of rejected ones, flags of the points near the last refit, and
    the refit as `least_squares` returns it, or the winner's axis in the same form without refits.
    """
    np.random.seed(seed)  # noqa: NPY002 - the compiled generator is faster to call than NumPy's
    m, limit = len(points), distance * distance
    coordinates = points.T.copy()
    sample = np.zeros(order, np.int64)
    curve, best_curve, best_length = np.zeros((3, 3)), np.zeros((3, 3)), 0.0
    best, rejected, draws, needed = 0, 0, 0, float(max_draws)
    while draws < min(needed, max_draws):
        draws += 1
        for n in range(order):
            sample[n] = np.random.randint(m)  # noqa: NPY002
        possible, length = _through(coordinates, sample, separation, bend, curve)
        cosine = curve[1, 0] * expected[0] + curve[1, 1] * expected[1] + curve[1, 2] * expected[2]
        if not possible or abs(cosine) < min_cosine:
            rejected += 1
            continue
        count = _count_near(coordinates, curve, length, limit, best)
        if count > best:
            best, best_length = count, length
            best_curve = curve.copy()
            ratio = (count / m) ** order
            # Rejected draws are allowed on top: they are the cost of finding admissible samples.
            needed = rejected
            if ratio < 1:
                needed += draws_factor * log_failure / np.log1p(-ratio)
    if np.sum(best_curve[1] * expected) < 0:
        for c in range(3):
            best_curve[0, c] += best_length * best_curve[1, c]
            best_curve[1, c] *= -1
    axis = np.concatenate((best_curve[:2], best_curve[:order]))
    for c in range(3):
        axis[3, c] -= best_length * best_curve[2, c]
    near = _near(coordinates, axis, limit)
    fit = (best > 0, axis, np.eye(order), np.zeros((3, 3)))
    for _ in range(refits):
        if not fit[0]:
            break
        selected = near
        fit = least_squares(coordinates, weights * selected, order, expected)
        near = _near(coordinates, fit[1], limit)
        if np.array_equal(near, selected):  # so would be the next refit
            break
    return draws, rejected, near, fit


def ransac_axis(
    points: NDArray[np.float64],
    weights: NDArray[np.float64],
    *,
    order: int,
    rng: np.random.Generator,
    parameters: RansacParameters | None = None,
    direction: NDArray[np.float64] | None = None,
    max_angle: float = math.pi / 2,
) -> RansacResult | NotFound:
    """Fit an axis by random sample consensus (Chatelain 2013, eqs. 17-22; Uhercik 2010).

    As many samples are drawn as eq. 21 requires for the best inlier ratio so far, times a factor.
    One is rejected unevaluated if its points nearly coincide, if it bends too much, or if it is off
    ``direction`` by more than ``max_angle`` rad (eq. 22). The winner is refitted on re-selected
    inliers.
    """
    require(order in (2, 3), "order", order, "2 or 3")
    parameters = parameters or RansacParameters()
    if len(points) <= order:
        return NotFound(f"{len(points)} candidates are too few for an axis of order {order}")
    expected = np.zeros(3) if direction is None else np.array(direction, float)  # writable
    min_cosine = 0.0 if direction is None else math.cos(max_angle)
    draws, rejected, inliers, solution = _consensus(
        np.ascontiguousarray(points),
        weights,
        order,
        int(rng.integers(2**32)),
        expected,
        min_cosine,
        parameters.residual_threshold,
        parameters.min_separation,
        parameters.max_bend,
        math.log1p(-parameters.stop_probability),
        parameters.draws_factor,
        parameters.max_trials,
        parameters.refits,
    )
    if draws == rejected:
        return NotFound(SearchReason.NOT_AS_EXPECTED(f" {draws} samples agrees with the needle"))
    fit = as_fit(solution, len(points))
    if isinstance(fit, NotFound):
        return fit
    if parameters.refits == 0:
        fit = assess_axis(fit.axis, points[inliers], weights[inliers])
    if direction is not None and fit.axis.direction @ expected < min_cosine:
        return NotFound("the fitted axis deviates from the expected direction")
    return RansacResult(fit, inliers, int(draws), int(rejected))
