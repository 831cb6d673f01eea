"""Localization of the needle in a single volume."""

from dataclasses import dataclass
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.diagrams.app.volumes.opening import ReconstructedRecording
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.recording.recording import Recording
from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.requirements import require, require_within
from sonoservo.systems.signals.sweep import DYNAMIC_RANGE_DB
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.localizer_parameters import NeedleLocalizerParameters
from sonoservo.systems.tracking.pipeline import explain_localization
from sonoservo.systems.tracking.volume_plausibility import (
    VolumePlausibilityParameters,
    implausible,
)

_FARTHEST = 5.0  # Distance of an array from the origin in m; a larger one is given in mm
_THINNEST = 2e-3  # Smallest extent of a volume in m; one of the cells that it is cut into must fit


@dataclass(frozen=True, eq=False)
class LocatedNeedle(Immutable):
    """A needle found in a volume; if none is found, a `NotFound` takes its place.

    Parameters
    ----------
    curve
        Curve of the needle from its entry into the field of view to its tip, in m.
    inlier_count, inlier_ratio
        Number of bright voxels on the needle, and their share of all bright voxels around it.
    confidence
        Probability that what was found is a needle, judged by this volume alone, if every second
        volume has one. A guide wire or another needle at rest cannot be told from it.
    covariance
        (3, 3) covariance of the tip, in m^2.
    """

    curve: NeedleCurve
    inlier_count: int
    inlier_ratio: float
    confidence: float
    covariance: NDArray[np.float64]


def locate(
    intensities: ArrayLike,
    spacing: ArrayLike,
    *,
    origin: ArrayLike = (0.0, 0.0, 0.0),
    order: int = 2,
    dynamic_range_db: float = 60.0,
    seed: int = 0,
) -> LocatedNeedle | NotFound:
    """Locate the needle in an array.

    Parameters
    ----------
    intensities
        (nx, ny, nz) log-compressed grey levels from 0 to 255; zero outside the field of view. The
        sound travels along the second axis.
    spacing
        (3,) distances between neighbouring elements, in m.
    origin
        (3,) position of the first element, in m.
    order
        Order of the curve: 2 for a straight needle, 3 for a bent one.
    dynamic_range_db
        Range of echo amplitudes that the grey levels 0 to 255 show, in dB.
    seed
        Seed of the random samples.

    Returns
    -------
    The needle in the array's coordinates, or a `NotFound` with the reason.
    """
    levels = np.asarray(intensities)
    require(not np.iscomplexobj(levels), "intensities", levels.dtype.name, "real numbers")
    require_within("dynamic_range_db", dynamic_range_db, *DYNAMIC_RANGE_DB)
    volume = Volume(
        levels,
        np.asarray(origin),
        np.asarray(spacing),
        RigidTransform(),
        0.0,
        decibels_per_level=dynamic_range_db / 255,
    )
    for axis, place in enumerate(volume.origin):
        allowed = f"within {_FARTHEST:g} m of 0; lengths are in m, and 20 mm is 20e-3"
        require(abs(place) <= _FARTHEST, f"origin[{axis}]", float(place), allowed)
    return locate_in(volume, order=order, seed=seed)


def locate_in(
    volume: Volume,
    *,
    order: int = 2,
    seed: int = 0,
    parameters: NeedleLocalizerParameters | None = None,
) -> LocatedNeedle | NotFound:
    """Locate the needle in a `Volume`, in W, with the localizer's parameters; see `locate`."""
    require(order in (2, 3), "order", order, "2 or 3")
    whole = isinstance(seed, Integral) and seed >= 0
    require(whole, "seed", seed, "a whole number of at least 0")
    thinnest = float((volume.spacing * volume.intensities.shape).min())
    if thinnest < _THINNEST:
        return NotFound(
            f"a volume is refused: it is {1e3 * thinnest:.2g} mm thin; at least "
            f"{1e3 * _THINNEST:g} mm along each axis is needed"
        )
    if reason := implausible(volume, None, None, volume.time, 0.0, VolumePlausibilityParameters()):
        return NotFound(f"a volume is refused: {reason}")
    anywhere = NeedlePrediction(order, volume.time, everywhere=True)
    explained = explain_localization(
        volume, anywhere, parameters or NeedleLocalizerParameters(), np.random.default_rng(seed)
    )
    found = explained.measurement
    if isinstance(found, NotFound):
        return found
    return LocatedNeedle(
        found.curve,
        found.inlier_count,
        found.inlier_ratio,
        explained.probability,
        found.covariance[-3:, -3:],
    )


def locate_in_recording(
    recording: Recording | ReconstructedRecording,
    number: int = 0,
    *,
    order: int = 2,
    parameters: NeedleLocalizerParameters | None = None,
) -> dict[str, Any]:
    """Locate the needle in a volume of a file; return figures to print, in mm in its frame."""
    if not 0 <= number < len(recording):
        raise ConfigurationError(
            f"{recording.path}: volume {number} is out of range (0 to {len(recording) - 1})"
        )
    found = locate_in(recording[number], order=order, parameters=parameters)
    result: dict[str, Any] = {"file": str(recording.path), "volume": number, "found": bool(found)}
    if isinstance(found, NotFound):
        return result | {"reason": found.reason}
    X_LW = recording.X_WL(number).inverse()
    curve, R_LW = found.curve.transformed(X_LW), X_LW.rotation().matrix()
    return result | {
        "frame": recording.frame,
        "entry_mm": (1e3 * curve.entry).tolist(),
        "tip_mm": (1e3 * curve.tip).tolist(),
        "tip_covariance_mm2": (1e6 * R_LW @ found.covariance @ R_LW.T).tolist(),
        "direction": curve.direction.tolist(),
        "control_points_mm": (1e3 * curve.control_points).tolist(),
        "length_mm": 1e3 * curve.chord,
        "inliers": found.inlier_count,
        "inlier_ratio": found.inlier_ratio,
        "confidence": found.confidence,
    }
