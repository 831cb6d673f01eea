"""Record of a tracker's search in one volume, in the form stored in a file."""

from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import numpy as np
from pydrake.math import RigidTransform

from sonoservo.systems.evaluation.log import Array, Column, Log, columns, read_log, write_log
from sonoservo.systems.evaluation.run_errors import at_times
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.signals.acquisition import acquired_from
from sonoservo.systems.signals.localization_explanation import (
    LocalizationAttempt,
    LocalizationExplanation,
)
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.planes import sample_plane, slice_planes
from sonoservo.systems.signals.sweep import SweepGeometry, SweepMotion
from sonoservo.systems.signals.volume import Volume

_PIXEL = 0.5e-3  # distance between the pixels of the slices, in m


@dataclass(frozen=True, eq=False, kw_only=True)
class ExplainedVolume(Log):
    """Record of a tracker's search in one volume, and of its result.

    Positions are in m, in W unless a column says otherwise. Of several searches, it holds the
    deciding one. Steps that it did not reach, and curves that do not exist, have no rows or are
    NaN.
    """

    volume_time: Annotated[Array, Column("middle of the volume's acquisition", "s", ())]
    occasion: Annotated[Array, Column("why the volume was kept", "", (), "U")]
    mode_before: Annotated[Array, Column("mode of the tracker before it", "", (), "U")]
    mode_after: Annotated[Array, Column("mode of the tracker after it", "", (), "U")]
    reason: Annotated[Array, Column("why it did not confirm the needle", "", (), "U")]
    attempt_reasons: Annotated[
        Array, Column("why each search failed; empty where it did not", "", ("t",), "U")
    ]

    X_WP: Annotated[Array, Column("pose of the probe at the volume's time", "m", (4, 4))]
    frame_times: Annotated[Array, Column("time of each frame, if known", "s", ("f",))]
    frame_X_WP: Annotated[Array, Column("pose of the probe at each frame", "m", ("f", 4, 4))]
    direction: Annotated[Array, Column("+1 if the sweep went towards +Z, -1 if not", "", ())]
    geometry: Annotated[Array, Column("fields of the `SweepGeometry`", "SI", (10,))]

    before_time: Annotated[Array, Column("time of the estimate before", "s", ())]
    before: Annotated[Array, Column("control points of the estimate before", "m", ("b", 3))]
    after_time: Annotated[Array, Column("time of the estimate after", "s", ())]
    after: Annotated[Array, Column("control points of the estimate after", "m", ("a", 3))]
    predicted: Annotated[Array, Column("control points expected in the volume", "m", ("p", 3))]
    measured_time: Annotated[Array, Column("time of the measured tip", "s", ())]
    measured: Annotated[Array, Column("control points measured in the volume", "m", ("q", 3))]
    measured_tip_covariance: Annotated[Array, Column("covariance of its tip", "m^2", (3, 3))]
    innovation: Annotated[
        Array, Column("Mahalanobis distance of the measurement from the prediction", "", ())
    ]
    gate: Annotated[Array, Column("largest such distance that is believed", "", ())]

    region: Annotated[Array, Column("control points of the region's axis", "m", ("r", 3))]
    region_radius: Annotated[Array, Column("radius of the region", "m", ())]
    region_before: Annotated[Array, Column("reach of the region before its axis", "m", ())]
    region_beyond: Annotated[Array, Column("reach of the candidates beyond it", "m", ())]
    candidates: Annotated[Array, Column("candidate voxels", "m", ("c", 3), "f4")]
    weights: Annotated[Array, Column("their weights", "", ("c",), "f4")]
    inliers: Annotated[Array, Column("whether each belongs to the consensus", "", ("c",), "?")]
    profile: Annotated[Array, Column("samples of the profile along the axis", "m", ("k", 3))]
    profile_a: Annotated[Array, Column("their abscissae", "m", ("k",))]
    profile_level: Annotated[Array, Column("intensity along the axis", "dB", ("k",))]
    profile_background: Annotated[Array, Column("intensity beside it", "dB", ("k",))]
    profile_seen: Annotated[Array, Column("whether the volume shows it", "", ("k",), "?")]
    contrast: Annotated[Array, Column("threshold of the level over the background", "dB", ())]
    start: Annotated[Array, Column("abscissa of the needle's visible start", "m", ())]
    tip: Annotated[Array, Column("abscissa of its tip", "m", ())]
    tip_seen: Annotated[Array, Column("probability that the tip is seen", "", ())]
    leaves: Annotated[
        Array, Column("whether it goes on beyond what was searched or seen", "", (), "?")
    ]

    sliced: Annotated[
        Array, Column("curve in the slices: measured, predicted, estimated, or none", "", (), "U")
    ]
    slice_origin: Annotated[Array, Column("its tip in P; zero without one", "m", (3,))]
    beam_slice: Annotated[Array, Column("slice along needle and beam", "", ("h", "w"), "u1")]
    beam_X_PS: Annotated[Array, Column("pose of its middle in P", "m", (4, 4))]
    beam_size: Annotated[Array, Column("its width and height", "m", (2,))]
    cross_slice: Annotated[Array, Column("slice along needle, across beam", "", ("i", "j"), "u1")]
    cross_X_PS: Annotated[Array, Column("pose of its middle in P", "m", (4, 4))]
    cross_size: Annotated[Array, Column("its width and height", "m", (2,))]

    @property
    def motion(self) -> SweepMotion | None:
        """Time and pose of each frame's acquisition; None if unknown."""
        if not len(self.frame_times):
            return None
        kinds = get_type_hints(SweepGeometry)
        geometry = SweepGeometry(
            **{name: kinds[name](value) for name, value in zip(kinds, self.geometry, strict=True)}
        )
        return SweepMotion(geometry, int(self.direction), self.frame_times, self.frame_X_WP)

    def to_probe(self, p_W: Array) -> Array:
        """Return the (m, 3) positions in P, in m, at which the volume shows positions in W."""
        return acquired_from(_Picture(RigidTransform(self.X_WP), self.motion), p_W)


@dataclass(frozen=True)
class _Picture:
    """Pose and motion of a volume's acquisition, without its intensities."""

    X_WP: RigidTransform
    motion: SweepMotion | None


def deciding_attempt(explanation: LocalizationExplanation) -> LocalizationAttempt | None:
    """Return the search that gave the measurement, or else the last that got furthest, if any."""
    for attempt in explanation.attempts:
        if attempt.measurement is explanation.measurement:
            return attempt
    steps = ("candidates", "inliers", "profile", "extent")
    return max(
        reversed(explanation.attempts),
        key=lambda each: sum(getattr(each, step) is not None for step in steps),
        default=None,
    )


def explain_volume(
    volume: Volume,
    explanation: LocalizationExplanation,
    *,
    before: NeedleEstimate | None,
    after: NeedleEstimate,
    occasion: str,
) -> ExplainedVolume:
    """Return the record of a tracker's search in a volume."""
    predicted, measured = explanation.prediction, explanation.measurement
    expected = predicted.curve if isinstance(predicted, NeedlePrediction) else None
    found = measured.curve if isinstance(measured, NeedleMeasurement) else None
    named = {"measured": found, "predicted": expected, "estimated": after.curve, "none": None}
    sliced = next(name for name, curve in named.items() if curve is not None or name == "none")
    known = columns(ExplainedVolume)
    arrays: dict[str, Any] = {name: _missing(column) for name, column in known.items()}
    arrays |= _acquisition(volume) | _slices(volume, named[sliced]) | _search(explanation)
    arrays |= {
        "volume_time": volume.time,
        "occasion": occasion,
        "mode_before": str(before.mode) if before is not None else "",
        "mode_after": str(after.mode),
        "reason": after.reason,
        "attempt_reasons": [getattr(a.measurement, "reason", "") for a in explanation.attempts],
        "before_time": before.time if before is not None else np.nan,
        "after_time": after.time,
        "sliced": sliced,
    }
    curves = {
        "before": before.curve if before is not None else None,
        "after": after.curve,
        "predicted": expected,
        "measured": found,
    }
    arrays |= {name: each.control_points for name, each in curves.items() if each is not None}
    if isinstance(measured, NeedleMeasurement):
        arrays["measured_time"] = measured.time
        arrays["measured_tip_covariance"] = measured.covariance[-3:, -3:]
    return ExplainedVolume(**arrays)


def _missing(column: Column) -> Array:
    """Return the array of a column without data."""
    shape = [extent if isinstance(extent, int) else 0 for extent in column.shape]
    if column.dtype == "U":
        return np.full(shape, "")
    return np.full(shape, np.nan if column.dtype[0] == "f" else 0, column.dtype)


def _acquisition(volume: Volume) -> dict[str, Any]:
    """Return the times and poses of a volume's acquisition."""
    arrays: dict[str, Any] = {"X_WP": volume.X_WP.GetAsMatrix4()}
    if volume.motion is not None:
        arrays["frame_times"] = volume.motion.times
        arrays["frame_X_WP"] = volume.motion.X_WP
        arrays["direction"] = volume.motion.direction
        arrays["geometry"] = astuple(volume.motion.geometry)
    return arrays


def _slices(volume: Volume, curve: NeedleCurve | None) -> dict[str, Any]:
    """Return the two orthogonal slices through a curve as the volume shows it."""
    arrays: dict[str, Any] = {"slice_origin": np.zeros(3)}
    if curve is not None:
        shown = NeedleCurve(acquired_from(volume, curve.control_points))
        arrays["slice_origin"] = shown.tip
        curve = shown.transformed(volume.X_WP)
    for name, plane in zip(("beam", "cross"), slice_planes(volume, curve), strict=False):
        arrays[f"{name}_slice"] = sample_plane(volume, plane, _PIXEL)
        arrays[f"{name}_X_PS"] = plane.X_PS.GetAsMatrix4()
        arrays[f"{name}_size"] = [plane.width, plane.height]
    return arrays


def _search(explanation: LocalizationExplanation) -> dict[str, Any]:
    """Return the steps of the deciding search."""
    compared = {"innovation": explanation.innovation, "gate": explanation.gate}
    arrays: dict[str, Any] = {name: value for name, value in compared.items() if value is not None}
    attempt = deciding_attempt(explanation)
    if attempt is None:
        return arrays
    region, profile, extent = attempt.region, attempt.profile, attempt.extent
    arrays["region"] = region.curve.control_points
    arrays["region_radius"] = region.radius
    arrays["region_before"] = region.before
    arrays["region_beyond"] = region.shaft_beyond
    if attempt.candidates is not None:
        none = np.zeros(len(attempt.candidates), bool)
        arrays["candidates"], arrays["weights"] = attempt.candidates, attempt.weights
        arrays["inliers"] = none if attempt.inliers is None else attempt.inliers
    if profile is not None:
        arrays["profile"], arrays["profile_a"] = profile.p_W, profile.a
        arrays["profile_level"], arrays["profile_seen"] = profile.level, profile.seen
        arrays["profile_background"] = profile.background
        arrays["contrast"] = np.nan if profile.contrast is None else profile.contrast
    if extent is not None:
        arrays["start"], arrays["tip"] = extent.start, extent.tip
        arrays["leaves"], arrays["tip_seen"] = extent.leaves, extent.seen
    return arrays


FOLDER = "explanation"  # name of the subfolder of the explained volumes

_FILES = "*s.npz"


def write_explanation(run: Path, explained: ExplainedVolume) -> Path:
    """Write an explained volume into the folder of a run, in a file named after its time."""
    return write_log(run / FOLDER / f"{float(explained.volume_time):08.3f}s.npz", explained)


def read_explanations(run: Path) -> list[ExplainedVolume]:
    """Read the explained volumes in the folder of a run, in order of time."""
    kept = [read_log(path, ExplainedVolume) for path in (run / FOLDER).glob(_FILES)]
    return sorted(kept, key=lambda each: float(each.volume_time))


def clear_explanations(run: Path) -> None:
    """Remove the explained volumes of an earlier run from the folder of a run."""
    for path in (run / FOLDER).glob(_FILES):
        path.unlink()
    if (run / FOLDER).is_dir() and not any((run / FOLDER).iterdir()):
        (run / FOLDER).rmdir()


_POINTS_EACH = 4  # number of segments between neighbouring points of the log


def imaged_needle(log: RunLog, explained: ExplainedVolume) -> Array:
    """Return (m, 3) points of the true needle in P as a volume shows it; none outside."""
    logged = np.linspace(0, 1, log.needle_points.shape[1])
    u = np.linspace(0, 1, _POINTS_EACH * (len(logged) - 1) + 1)
    times = np.full(len(u), float(explained.volume_time))
    p_P = np.zeros((0, 3))
    for _ in range(3):  # position and time of a point's acquisition depend on each other
        needles = at_times(log, log.needle_points, times)
        if not np.isfinite(needles).all():
            return np.zeros((0, 3))
        points = [
            [np.interp(each, logged, axis) for axis in needle.T]
            for each, needle in zip(u, needles, strict=True)
        ]
        p_P = explained.to_probe(np.array(points))
        if explained.motion is None:
            break
        times = explained.motion.to_world(p_P)[1]
    return p_P
