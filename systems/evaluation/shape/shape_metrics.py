"""Metrics of a predicted needle shape (Carriere 2016, section V)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.evaluation.labels import look_up
from sonoservo.systems.evaluation.log import Array, Log, Row, column, columns, stack_rows
from sonoservo.systems.evaluation.metrics import spread
from sonoservo.systems.evaluation.reports.verdict import Verdict
from sonoservo.systems.signals.bicycle_paths import deflections
from sonoservo.systems.signals.confidence import SQUARED_DISTANCE_95
from sonoservo.systems.signals.curvature_wander import wander_modes
from sonoservo.systems.signals.needle_shape import NeedleShape

Floats = NDArray[np.float64]


OFF_NEEDLE = 2e-3  # distance from the needle beyond which a cross-section has drifted off it, in m

LABELS = {
    "tracking.slices": "slices",
    "tracking.found": "of these, cross-section found",
    "tracking.error_mm.median": "cross-section's error, median, mm",
    "tracking.error_mm.p95": "cross-section's error, 95 %, mm",
    "prediction.observed_mm": "depth of the last slice used, mm",
    "prediction.tip_error_measured_mm": "predicted tip against the measured one, mm",
    "prediction.tip_error_true_mm": "predicted tip against the true one, mm",
    "prediction.tip_std_mm": "standard deviation that the estimate states, mm",
    "prediction.shape_error_measured_mm2": "predicted shape against the measured one, mm²",
    "prediction.shape_error_true_mm2": "predicted shape against the true one, mm²",
    "prediction.max_error_true_mm": "largest distance from the true shape, mm",
    "compute_ms.image.median": "finding the cross-section, median, ms",
    "compute_ms.estimate.median": "estimating the shape, median, ms",
    "compute_ms.total.median": "both, median, ms",
    "compute_ms.total.max": "both, largest, ms",
    "real_time_factor": "simulated time / wall time",
}
"""Label of each figure of a summary that tables show, by its dotted path."""


@dataclass(frozen=True)
class ShapeErrors:
    """Errors of a predicted shape."""

    tip: float  # |u - u^| at the last depth, in m
    shape: float  # integral of |u - u^| over depth (eq. 8), in m^2
    largest: float  # largest distance perpendicular to Z, in m


def plane_of(path: Floats) -> Floats:
    """Return the (2,) unit vector u of the plane through Z in which a path (m, 3) deflects most."""
    across = path[:, :2] - path[:, :2].mean(axis=0)
    _, _, axes = np.linalg.svd(across)
    axis: Floats = axes[0]
    return axis


def shape_errors(path: Floats, predicted: Floats) -> ShapeErrors:
    """Return the errors of (m, 2) predicted positions against an (m, 3) path, both in I, in m."""
    apart = predicted - path[:, :2]
    u = apart @ plane_of(path)
    return ShapeErrors(
        tip=float(abs(u[-1])),
        shape=float(np.trapezoid(np.abs(u), path[:, 2])),
        largest=float(np.linalg.norm(apart, axis=1).max()),
    )


def shape_coverage(shape: NeedleShape, path: Floats) -> dict[str, float]:
    """Check whether the estimate's 95 % regions cover an (m, 3) path in I, in m."""
    mean, covariance = shape.predict(path[:, 2])
    apart = path[:, :2] - mean
    # Regularised, because the covariance is zero at depths where the estimate has no spread.
    covariance = covariance + (1e-9) ** 2 * np.eye(2)
    distance = np.einsum("mi,mi->m", apart, np.linalg.solve(covariance, apart[..., None])[..., 0])
    u = plane_of(path)
    possible = np.trapezoid(np.abs((shape.paths(path[:, 2]) - mean) @ u), path[:, 2], axis=1)
    order = np.argsort(possible)
    below = np.cumsum(shape.weights[order])
    bound = possible[order][min(int(np.searchsorted(below, 0.95)), len(order) - 1)]
    area = np.trapezoid(np.abs(apart @ u), path[:, 2])
    return {
        "tip": float(distance[-1] <= SQUARED_DISTANCE_95),
        "shape": float(area <= bound),
        "points": float(np.mean(distance <= SQUARED_DISTANCE_95)),
    }


@dataclass(frozen=True, eq=False, kw_only=True)
class ShapeLog(Log):
    """Log with one row for each slice, in m in the probe frame I of the first slice.

    The truth is where the needle's axis would cross the slice if the tissue had not moved.
    """

    depth: Array = column("depth of the slice", "m", "n")
    measured: Array = column("cross-section of the needle that was found", "m", "n 3")
    true: Array = column("truth: the needle's axis in the slice", "m", "n 3")
    correlation: Array = column("correlation with the template", "", "n")
    reason: Array = column("why no cross-section was found", "", "n", "U")
    tip: Array = column("predicted x and y of the tip at full depth after the slice", "m", "n 2")
    tip_covariance: Array = column("covariance of `tip`", "m^2", "n 2 2")
    image_s: Array = column("processor time of the tracker", "s", "n")
    estimate_s: Array = column("processor time of the estimator", "s", "n")

    @classmethod
    def from_rows(cls, rows: Sequence[Row], true_path: Callable[[Array], Array]) -> Self:
        """Make a log from rows that may lack values."""
        arrays: dict[str, Any] = {
            name: stack_rows(column, name, rows) for name, column in columns(cls).items()
        }
        return cls(**{**arrays, "true": true_path(arrays["depth"])})


def cross_section_errors(log: ShapeLog) -> Floats:
    """Return the (n,) distances of the cross-sections from the needle, in m; NaN if not found."""
    return np.linalg.norm(log.measured[:, :2] - log.true[:, :2], axis=1)


def tracked_to_the_end(log: ShapeLog) -> bool:
    """Return True if the last cross-section was found and none drifted off the needle."""
    errors = cross_section_errors(log)
    return bool(np.isfinite(errors[-1]) and not np.any(errors > OFF_NEEDLE))


def summarize_shape(log: ShapeLog, shape: object) -> dict[str, Any]:
    """Summarise a run in blocks of figures for JSON; a figure without a value is None."""
    errors = 1e3 * cross_section_errors(log)
    found = errors[np.isfinite(errors)]
    compute = {
        "image": 1e3 * log.image_s,
        "estimate": 1e3 * log.estimate_s,
        "total": 1e3 * (log.image_s + log.estimate_s),
    }
    summary: dict[str, Any] = {
        "tracking": {
            "slices": len(errors),
            "found": len(found),
            "to_the_end": tracked_to_the_end(log) if len(errors) else False,
            "tip_found": bool(len(errors) and np.isfinite(errors[-1])),
            "error_mm": spread(found),
        },
        "prediction": prediction(log, shape) if isinstance(shape, NeedleShape) else {},
        "compute_ms": {name: spread(each[1:]) for name, each in compute.items()},
    }
    return summary


def prediction(log: ShapeLog, shape: NeedleShape) -> dict[str, Any]:
    """Return a predicted shape's errors against the measured and true paths, and its coverage."""
    mean, covariance = shape.predict(log.depth)
    true = shape_errors(log.true, mean)
    found = np.isfinite(log.measured[:, 0])
    figures: dict[str, float | None] = {
        "observed_mm": 1e3 * shape.observed,
        "tip_error_true_mm": 1e3 * true.tip,
        "shape_error_true_mm2": 1e6 * true.shape,
        "max_error_true_mm": 1e3 * true.largest,
        "tip_std_mm": 1e3 * float(np.sqrt(np.linalg.eigvalsh(covariance[-1])[-1])),
    }
    if found.sum() > 2:
        measured = shape_errors(log.measured[found], mean[found])
        # A tip that was not found has no error, and counts as missing.
        figures["tip_error_measured_mm"] = 1e3 * measured.tip if found[-1] else None
        figures["shape_error_measured_mm2"] = 1e6 * measured.shape
    figures |= {f"covers_{name}": each for name, each in shape_coverage(shape, log.true).items()}
    return figures


def shape_verdict(summary: Mapping[str, Any]) -> Verdict:
    """Return the verdict on a run of shape prediction, from its summary."""
    tracking = summary["tracking"]
    text = f"Its cross-section was found in {tracking['found']} of {tracking['slices']} slices"
    median = look_up(tracking, "error_mm.median")
    text += "." if median is None else f", {median:.2f} mm from the true one (median)."
    if summary.get("interrupted"):
        text = f"The run was interrupted. {text}"
    prediction = summary["prediction"]
    if "tip_error_true_mm" not in prediction:
        return Verdict("The needle's shape was not predicted", text, "bad")
    headline = (
        f"From the first {prediction['observed_mm']:.0f} mm, the tip was predicted to "
        f"{prediction['tip_error_true_mm']:.2f} mm"
    )
    held = 100 * prediction["covers_points"]
    text = (
        f"The estimate states a standard deviation of {prediction['tip_std_mm']:.2f} mm, and its "
        f"95 % tube holds the true needle at {held:.0f} % of the depths. {text}"
    )
    good = tracking["to_the_end"] and prediction["covers_tip"]
    return Verdict(headline, text, "good" if good else "mixed")


_WIDE = 0.1  # standard deviation in m of the unknown origin, which leaves it free


@dataclass(frozen=True, kw_only=True)
class TrueBend:
    """True path of a needle, and what is known of all needles."""

    radius: float  # R in m
    angle: float  # first angle theta_0 in rad
    rotations: Sequence[float] = ()  # depths at which the bevel is turned, in m
    wander: float = 0.0  # standard deviation of the curvature, relative to its mean
    wander_length: float = 0.02
    radius_std: float = 0.6  # over all needles, in m
    angle_std: float = 0.0873  # over all needles, in rad


def deflection_bound(bend: TrueBend, seen: Floats, noise_std: float, depths: Floats) -> Floats:
    """Return the (k,) least standard deviations of a predicted deflection u, in m.

    Bayesian Cramer-Rao bound (Van Trees 1968) at the true path. The unknowns are the origin, R,
    theta_0 and the wander; an error of the plane does not change u to first order.
    """
    modes = wander_modes(float(depths[-1]), bend.rotations, bend.wander_length)
    prior = [_WIDE, bend.radius_std, bend.angle_std]
    prior += len(modes) * [bend.wander / bend.radius] if bend.wander else []
    scale = np.array(prior)

    def derivatives(at: Floats) -> Floats:
        steps = np.array([[0, 0], [1e-4, 0], [0, 1e-6]])
        shapes = np.array([1 / bend.radius, np.sin(bend.angle)]) + steps
        u, curved, turned = deflections(shapes, at, np.array(bend.rotations, dtype=float))
        radius = (u - curved) / 1e-4 / bend.radius**2
        columns = [np.ones(len(at)), radius, (turned - u) / 1e-6 * np.cos(bend.angle)]
        unknown = np.column_stack(columns)
        return np.hstack([unknown, modes.at(at)]) if bend.wander else unknown

    known = derivatives(seen) * scale
    information = known.T @ known / noise_std**2 + np.eye(len(scale))
    wanted = derivatives(depths) * scale
    variance = np.einsum("ki,ki->k", wanted, np.linalg.solve(information, wanted.T).T)
    return np.sqrt(variance)
