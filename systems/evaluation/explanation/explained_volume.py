"""Record of a tracker's search in a volume, and the leaf system that keeps those around a loss."""

from collections import deque
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.evaluation.log import (
    Array,
    Log,
    column,
    columns,
    read_log,
    write_log,
)
from sonoservo.systems.evaluation.run_errors import at_times
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.leaves import declare_looks, declare_memory
from sonoservo.systems.signals.line_hypotheses import LinesExplanation
from sonoservo.systems.signals.localization_explanation import (
    LocalizationAttempt,
    LocalizationExplanation,
)
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.planes import sample_plane, slice_planes
from sonoservo.systems.signals.ports import declare_inputs, evaluate, evaluate_optional
from sonoservo.systems.signals.requirements import require, require_positive
from sonoservo.systems.signals.sweep import SweepGeometry, SweepMotion
from sonoservo.systems.signals.volume import Volume, acquired_from

_PIXEL = 0.5e-3  # distance between the pixels of the slices, in m


@dataclass(frozen=True, eq=False, kw_only=True)
class ExplainedVolume(Log):
    """Record of a tracker's search in one volume, and of its result.

    Positions are in m, in W unless a column says otherwise. Of several searches, it holds the
    deciding one. Steps that it did not reach, and curves that do not exist, have no rows or are
    NaN.
    """

    volume_time: Array = column("middle of the volume's acquisition", "s")
    occasion: Array = column("why the volume was kept", "", "", "U")
    mode_before: Array = column("mode of the tracker before it", "", "", "U")
    mode_after: Array = column("mode of the tracker after it", "", "", "U")
    reason: Array = column("why it did not confirm the needle", "", "", "U")
    attempt_reasons: Array = column("why each search failed; empty where it did not", "", "t", "U")

    X_WP: Array = column("pose of the probe at the volume's time", "m", "4 4")
    frame_times: Array = column("time of each frame, if known", "s", "f")
    frame_X_WP: Array = column("pose of the probe at each frame", "m", "f 4 4")
    direction: Array = column("+1 if the sweep went towards +Z, -1 if not", "")
    geometry: Array = column("fields of the `SweepGeometry`", "SI", "10")

    before_time: Array = column("time of the estimate before", "s")
    before: Array = column("control points of the estimate before", "m", "b 3")
    after_time: Array = column("time of the estimate after", "s")
    after: Array = column("control points of the estimate after", "m", "a 3")
    predicted: Array = column("control points expected in the volume", "m", "p 3")
    measured_time: Array = column("time of the measured tip", "s")
    measured: Array = column("control points measured in the volume", "m", "q 3")
    measured_tip_covariance: Array = column("covariance of its tip", "m^2", "3 3")
    innovation: Array = column("Mahalanobis distance of the measurement from the prediction", "")
    gate: Array = column("largest such distance that is believed", "")

    region: Array = column("control points of the region's axis", "m", "r 3")
    region_radius: Array = column("radius of the region", "m")
    region_before: Array = column("reach of the region before its axis", "m")
    region_beyond: Array = column("reach of the candidates beyond it", "m")
    candidates: Array = column("candidate voxels", "m", "c 3", "f4")
    weights: Array = column("their weights", "", "c", "f4")
    inliers: Array = column("whether each belongs to the consensus", "", "c", "?")
    profile: Array = column("samples of the profile along the axis", "m", "k 3")
    profile_a: Array = column("their abscissae", "m", "k")
    profile_level: Array = column("intensity along the axis", "dB", "k")
    profile_background: Array = column("intensity beside it", "dB", "k")
    profile_seen: Array = column("whether the volume shows it", "", "k", "?")
    profile_before: Array = column("contrast before the needle came; NaN where unknown", "dB", "k")
    contrast: Array = column("threshold of the level over the background", "dB")
    start: Array = column("abscissa of the needle's visible start", "m")
    tip: Array = column("abscissa of its tip", "m")
    tip_seen: Array = column("probability that the tip is seen", "")
    leaves: Array = column("whether it goes on beyond what was searched or seen", "", "", "?")

    line_numbers: Array = column("lines most like a needle, the first one first", "", "l")
    line_probabilities: Array = column("probabilities that each is one", "", "l")
    line_classes: Array = column("probabilities of what each is by its motion", "", "l 5")
    line_looks: Array = column("log odds by its looks alone", "", "l")
    line_ends: Array = column("their ends, the tip last", "m", "l 2 3")
    history_times: Array = column("times of the volumes remembered", "s", "v")
    history_a: Array = column("abscissae along the first line, from its outer end", "m", "g")
    history: Array = column("contrasts along it in each of these volumes", "dB", "v g", "f4")

    sliced: Array = column(
        "curve in the slices: measured, predicted, estimated, line, or none", "", "", "U"
    )
    slice_origin: Array = column("its tip in P; zero without one", "m", "3")
    beam_slice: Array = column("slice along needle and beam", "", "h w", "u1")
    beam_X_PS: Array = column("pose of its middle in P", "m", "4 4")
    beam_size: Array = column("its width and height", "m", "2")
    cross_slice: Array = column("slice along needle, across beam", "", "i j", "u1")
    cross_X_PS: Array = column("pose of its middle in P", "m", "4 4")
    cross_size: Array = column("its width and height", "m", "2")

    @property
    def motion(self) -> SweepMotion | None:
        """Time and pose of each frame's acquisition; None if unknown."""
        if not len(self.frame_times):
            return None
        kinds = get_type_hints(SweepGeometry).values()
        geometry = (kind(value) for kind, value in zip(kinds, self.geometry, strict=True))
        return SweepMotion(
            SweepGeometry(*geometry), int(self.direction), self.frame_times, self.frame_X_WP
        )

    def to_probe(self, p_W: Array) -> Array:
        """Return the (m, 3) positions in P, in m, at which the volume shows positions in W."""
        return acquired_from(_Picture(RigidTransform(self.X_WP), self.motion), p_W)


class _Picture(NamedTuple):
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
    lines: LinesExplanation | None = None,
    before: NeedleEstimate | None,
    after: NeedleEstimate,
    occasion: str,
) -> ExplainedVolume:
    """Return the record of a tracker's search in a volume, along lines that it follows, if any."""
    predicted, measured = explanation.prediction, explanation.measurement
    curves = {
        "measured": measured.curve if isinstance(measured, NeedleMeasurement) else None,
        "predicted": predicted.curve if isinstance(predicted, NeedlePrediction) else None,
        "after": after.curve,
        "before": before.curve if before is not None else None,
    }
    arrays: dict[str, Any] = {
        name: each.missing([extent if isinstance(extent, int) else 0 for extent in each.shape])
        for name, each in columns(ExplainedVolume).items()
    }
    arrays |= {name: each.control_points for name, each in curves.items() if each is not None}
    if lines is not None:
        curves["line"] = NeedleCurve(lines.lines.ends[0])
    drawn = next(
        (each for each in ("measured", "predicted", "after", "line") if curves.get(each)), "none"
    )
    arrays |= _slices(volume, curves.get(drawn)) | _search(explanation)
    arrays |= {
        "volume_time": volume.time,
        "X_WP": volume.X_WP.GetAsMatrix4(),
        "occasion": occasion,
        "mode_before": str(before.mode) if before is not None else "",
        "mode_after": str(after.mode),
        "reason": after.reason,
        "attempt_reasons": [getattr(a.measurement, "reason", "") for a in explanation.attempts],
        "before_time": before.time if before is not None else np.nan,
        "after_time": after.time,
        "sliced": "estimated" if drawn == "after" else drawn,
    }
    if lines is not None:
        names = ("numbers", "probabilities", "classes", "looks", "ends")
        arrays |= {f"line_{name}": getattr(lines.lines, name) for name in names}
        arrays |= {"history_times": lines.times, "history_a": lines.a}
        arrays["history"] = np.where(lines.seen, lines.contrasts, np.nan)
    if (motion := volume.motion) is not None:
        arrays |= {"frame_times": motion.times, "frame_X_WP": motion.X_WP}
        arrays |= {"direction": motion.direction, "geometry": astuple(motion.geometry)}
    if isinstance(measured, NeedleMeasurement):
        arrays["measured_time"] = measured.time
        arrays["measured_tip_covariance"] = measured.covariance[-3:, -3:]
    return ExplainedVolume(**arrays)


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
    """Return the steps of the deciding search, as far as it came."""
    found: dict[str, Any] = {"innovation": explanation.innovation, "gate": explanation.gate}
    if (attempt := deciding_attempt(explanation)) is not None:
        region, profile, extent = attempt.region, attempt.profile, attempt.extent
        found |= {"region": region.curve.control_points, "region_radius": region.radius}
        found |= {"region_before": region.before, "region_beyond": region.shaft_beyond}
        if attempt.candidates is not None:
            none = np.zeros(len(attempt.candidates), bool)
            found |= {"candidates": attempt.candidates, "weights": attempt.weights}
            found["inliers"] = none if attempt.inliers is None else attempt.inliers
        if profile is not None:
            found |= {"profile": profile.p_W, "contrast": profile.contrast}
            for name in ("a", "level", "background", "seen"):
                found[f"profile_{name}"] = getattr(profile, name)
            found["profile_before"] = np.full(len(profile.a), np.nan)
            if profile.before is not None and profile.looks is not None:
                found["profile_before"] = np.where(profile.looks > 0.5, profile.before, np.nan)
        if extent is not None:
            found |= {"start": extent.start, "tip": extent.tip}
            found |= {"leaves": extent.leaves, "tip_seen": extent.seen}
    return {name: value for name, value in found.items() if value is not None}


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


BEFORE, AFTER = "before", "after"
"""Names for the volumes kept because they precede or follow an occasion."""


class _Look(NamedTuple):
    """A volume that was searched, and the estimates before and after it."""

    volume: Volume
    explanation: LocalizationExplanation
    lines: LinesExplanation | None
    before: NeedleEstimate | None
    after: NeedleEstimate


@dataclass
class _Run:
    """Memory of a run: the volumes that may still be written, and the number that will be."""

    waiting: deque[_Look] = field(default_factory=deque)
    following: int = 0
    estimate: NeedleEstimate | None = None
    detected: bool = False
    begun: bool = False


class ExplanationRecorder(LeafSystem):
    """Records a tracker's search in the volumes around a loss, in one file for each.

    .. pydrake_system::

        name: ExplanationRecorder
        input_ports:
        - volume
        - estimate
        - explanation
        - lines_explanation (optional)
        - detection (optional)

    A volume is kept when the tracker's mode changes, at the first detection and when the tip jumps
    (`find_occasion`), with some before and after it. `explanation` is evaluated after the tracker's
    update, when the gate has judged; this localizes the needle once more. A run removes the files
    of an earlier one.

    Parameters
    ----------
    folder
        Folder of the run; the files are in its subfolder ``explanation``.
    before, after
        Numbers of volumes to keep before and after an occasion.
    max_jump
        Largest distance of the tip from its expected position that is not a jump, in m.
    period, offset
        Period of the checks for a new volume and time of the first one, in s.
    """

    def __init__(
        self,
        *,
        folder: Path,
        before: int = 2,
        after: int = 2,
        max_jump: float = 3e-3,
        period: float = 1.0,
        offset: float = 0.0,
    ) -> None:
        super().__init__()
        require_positive(max_jump=max_jump)
        for name, count in (("before", before), ("after", after)):
            require(count >= 0, name, count, "0 or more")
        self._folder = folder
        self._before, self._after, self._max_jump = before, after, max_jump
        declare_inputs(
            self,
            volume=(Volume, NotFound),
            estimate=NeedleEstimate,
            explanation=(LocalizationExplanation, NotFound),
            lines_explanation=(LinesExplanation, NotFound),
            detection=object,
        )
        self._run = declare_memory(self, _Run)
        declare_looks(self, self._look, period=period, offset=offset, start=self._start)

    def _start(self, context: Context) -> None:
        vars(self._run(context)).update(vars(_Run()))

    def _look(self, context: Context) -> None:
        """Process the volume if it is new and the estimate was made from it."""
        run = self._run(context)
        if not run.begun:
            clear_explanations(self._folder)
            (self._folder / FOLDER).mkdir(parents=True, exist_ok=True)
            run.begun = True
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        before, after = run.estimate, evaluate(self, context, "estimate", NeedleEstimate)
        if not isinstance(volume, Volume) or volume.time != after.volume_time:
            return
        if before is not None and before.volume_time >= volume.time:
            return
        explanation = evaluate(self, context, "explanation", (LocalizationExplanation, NotFound))
        if not isinstance(explanation, LocalizationExplanation):
            return
        first = bool(evaluate_optional(self, context, "detection", object)) and not run.detected
        occasion = find_occasion(before, after, detected=first, max_jump=self._max_jump)
        run.detected |= first
        run.estimate = after
        lines = evaluate_optional(self, context, "lines_explanation", (LinesExplanation, NotFound))
        lines = lines if isinstance(lines, LinesExplanation) else None
        run.waiting.append(_Look(volume, explanation, lines, before, after))
        if occasion:
            while len(run.waiting) > 1:
                self._write(run.waiting.popleft(), BEFORE)
            run.following = self._after + 1
        if run.following:
            self._write(run.waiting.popleft(), occasion or AFTER)
            run.following -= 1
        elif len(run.waiting) > self._before:
            run.waiting.popleft()

    def _write(self, look: _Look, occasion: str) -> None:
        explained = explain_volume(
            look.volume,
            look.explanation,
            lines=look.lines,
            before=look.before,
            after=look.after,
            occasion=occasion,
        )
        write_explanation(self._folder, explained)


def find_occasion(
    before: NeedleEstimate | None, after: NeedleEstimate, *, detected: bool, max_jump: float
) -> str:
    """Return the reason why a volume is worth explaining; an empty text if it is not."""
    if before is None:
        return "first volume" if after.mode == TrackingMode.TRACKING else ""
    if before.mode != after.mode:
        return f"{before.mode} to {after.mode}"
    if detected:
        return "first detection"
    if before.curve is None or after.curve is None:
        return ""
    expected = before.curve.tip + before.tip_velocity * (after.time - before.time)
    jump = float(np.linalg.norm(after.curve.tip - expected))
    # The tip need not be wrong: the phantom may have moved.
    return f"the tip is {1e3 * jump:.1f} mm from where it was expected" if jump > max_jump else ""
