"""Robust fit of a needle's axis to voxels of which many are not the needle's."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.localization.axis import AxisFit, assess_axis, axis_through, fit_axis
from sonoservo.systems.values import NotFound, require, require_positive


@dataclass(kw_only=True)
class RansacParameters:
    """Of the random sample consensus; the paper publishes none of these values.

    Parameters
    ----------
    inlier_distance
        f_0: from the axis, in m.
    least_separation
        Between neighbouring points of a sample along the axis, in m: closer ones say nothing.
    largest_bend
        Of a curve of order 3: sagitta over chord.
    failure
        epsilon: probability that no sample was free of outliers.
    largest_iterations
        Cap on the draws, rejected ones included.
    refits
        Least-squares refits on re-selected inliers. With none, here and between the needle's ends,
        the winning sample's axis remains as it is, for comparison.
    """

    inlier_distance: float = 2e-3
    least_separation: float = 2e-3
    largest_bend: float = 0.1
    failure: float = 1e-3
    largest_iterations: int = 3000
    refits: int = 3

    def __post_init__(self) -> None:
        require_positive(
            inlier_distance=self.inlier_distance,
            least_separation=self.least_separation,
            largest_bend=self.largest_bend,
            failure=self.failure,
        )
        require(self.failure < 1, "failure", self.failure, "below 1")
        require(
            self.largest_iterations >= 1, "largest_iterations", self.largest_iterations, "1 or more"
        )
        require(self.refits >= 0, "refits", self.refits, "0 or more")


@dataclass(frozen=True, eq=False)
class RansacResult:
    """What the consensus found.

    Parameters
    ----------
    fit
        Least-squares fit on the inliers; the winning sample's axis where there are no refits.
    inliers
        (m,) which points lie within the inlier distance.
    draws, rejected
        Samples drawn, and how many of them were rejected unevaluated.
    """

    fit: AxisFit
    inliers: NDArray[np.bool_]
    draws: int
    rejected: int


# A raw winner is an all-inlier draw but often a poor model: with three times the draws of eq. 20
# and three refits on re-selected inliers none of 500 trials failed, against 27-32 % without.
_MORE_DRAWS = 3.0


@njit(cache=True, nogil=True, error_model="numpy")
def _search(  # pragma: no cover - compiled
    points: Any,
    samples: Any,
    expected: Any,
    least_cosine: float,
    distance: float,
    separation: float,
    bend: float,
    log_failure: float,
) -> Any:
    """Find the sample whose curve has most points within `distance`; -1 if none was admissible."""
    m, order = points.shape[0], samples.shape[1]
    best, best_count, rejected, draws = -1, 0, 0, 0
    needed = float(samples.shape[0])
    limit = distance * distance
    while draws < samples.shape[0] and draws < needed:
        s = samples[draws]
        draws += 1
        first, last, middle = points[s[0]], points[s[1]], points[s[0]]
        if order == 3:
            # The two farthest apart are the ends.
            third = points[s[2]]
            d01 = np.sum((first - last) ** 2)
            d02 = np.sum((first - third) ** 2)
            d12 = np.sum((last - third) ** 2)
            if d01 >= d02 and d01 >= d12:
                middle = third
            elif d02 >= d12:
                middle, last = last, third
            else:
                middle, first = first, third
        chord = last - first
        length = np.sqrt(np.sum(chord**2))
        if length < separation:
            rejected += 1
            continue
        k = chord / length
        if abs(np.sum(k * expected)) < least_cosine:
            rejected += 1
            continue
        # Order 3: C(a) = first + a k + b a (a - length), through the middle point.
        b0 = b1 = b2 = 0.0
        if order == 3:
            am = np.sum((middle - first) * k)
            if am < separation or am > length - separation:
                rejected += 1
                continue
            factor = 1.0 / (am * (am - length))
            b0 = (middle[0] - first[0] - am * k[0]) * factor
            b1 = (middle[1] - first[1] - am * k[1]) * factor
            b2 = (middle[2] - first[2] - am * k[2]) * factor
            if np.sqrt(b0 * b0 + b1 * b1 + b2 * b2) * length > 4 * bend:
                rejected += 1
                continue
        count = 0
        for i in range(m):
            x = points[i, 0] - first[0]
            y = points[i, 1] - first[1]
            z = points[i, 2] - first[2]
            a = x * k[0] + y * k[1] + z * k[2]
            q = a * (a - length)
            x -= a * k[0] + q * b0
            y -= a * k[1] + q * b1
            z -= a * k[2] + q * b2
            if x * x + y * y + z * z < limit:
                count += 1
        if count > best_count:
            best, best_count = draws - 1, count
            ratio = (count / m) ** order
            if ratio >= 1:
                break
            # Rejected draws count too: they are what it costs to find an admissible sample.
            needed = min(needed, _MORE_DRAWS * log_failure / np.log1p(-ratio) + rejected)
    return best, draws, rejected


def ransac_axis(
    points: NDArray[np.float64],
    weights: NDArray[np.float64],
    *,
    order: int,
    rng: np.random.Generator,
    parameters: RansacParameters | None = None,
    direction: NDArray[np.float64] | None = None,
    largest_angle: float = math.pi / 2,
) -> RansacResult | NotFound:
    """Fit an axis by random sample consensus (Chatelain 2013, eqs. 17-22; Uhercik 2010).

    Samples of ``order`` points are drawn until eq. 21 with the best inlier ratio so far is met
    three times over; a sample whose points nearly coincide, that bends too much or that deviates
    from the expected direction (eq. 22) is rejected unevaluated. The winner is refitted by
    weighted least squares on re-selected inliers.

    Parameters
    ----------
    points
        (m, 3) candidates in m.
    weights
        (m,) of the refits.
    order
        n: 2 for a straight axis, 3 for a bent one.
    rng
        Draws the samples.
    parameters
        Thresholds.
    direction, largest_angle
        Expected direction, and the largest angle alpha_0 from it in rad; the sign of the direction
        does not matter, but orients the result.

    Returns
    -------
    The result, or a `NotFound` that says why there is none.
    """
    require(order in (2, 3), "order", order, "2 or 3")
    parameters = parameters or RansacParameters()
    if len(points) <= order:
        return NotFound(f"{len(points)} candidates are too few for an axis of order {order}")
    expected = np.zeros(3) if direction is None else np.asarray(direction, dtype=float)
    least_cosine = 0.0 if direction is None else math.cos(largest_angle)
    samples = rng.integers(0, len(points), (parameters.largest_iterations, order))
    best, draws, rejected = _search(
        np.ascontiguousarray(points),
        samples,
        expected,
        least_cosine,
        parameters.inlier_distance,
        parameters.least_separation,
        parameters.largest_bend,
        math.log(parameters.failure),
    )
    if best < 0:
        return NotFound(f"none of {draws} samples agrees with the expected needle")
    sample = points[samples[best]]
    if order == 3:
        reach = np.linalg.norm(sample[:, np.newaxis] - sample, axis=-1)
        a, c = np.unravel_index(np.argmax(reach), reach.shape)
        sample = sample[[a, 3 - a - c, c]]
    axis = axis_through(sample)
    if isinstance(axis, NotFound):
        return axis
    for _ in range(parameters.refits):
        inliers = axis.distance(points) < parameters.inlier_distance
        fit = fit_axis(points[inliers], weights[inliers], order)
        if isinstance(fit, NotFound):
            return fit
        axis = fit.axis
    inliers = axis.distance(points) < parameters.inlier_distance
    if parameters.refits == 0:
        fit = assess_axis(axis, points[inliers], weights[inliers])
    assert isinstance(fit, AxisFit)
    if direction is not None:
        cosine = float(fit.axis.direction @ expected)
        if abs(cosine) < least_cosine:
            return NotFound("the fitted axis deviates from the expected direction")
        if cosine < 0:
            fit = fit.reversed()
    return RansacResult(fit, inliers, int(draws), int(rejected))
