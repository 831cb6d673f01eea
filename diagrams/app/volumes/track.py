"""Tracking in recorded volumes: results that print and draw themselves, and their files."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from pydrake.math import RigidTransform

from sonoservo.diagrams.app.options import refusing_values
from sonoservo.diagrams.app.own_tracker import OwnTracker, as_system
from sonoservo.diagrams.app.pages.pacer import Pacer
from sonoservo.diagrams.app.run_result import RunResult, table_text
from sonoservo.diagrams.app.terminal import mode_table
from sonoservo.diagrams.app.volumes.calibrate import pose_error_figures
from sonoservo.diagrams.app.volumes.estimates_table import ModeCount, estimate_row, estimates_csv
from sonoservo.diagrams.app.volumes.opening import Opened
from sonoservo.diagrams.needle_tracker import MakeNeedleTracker, require_tracker
from sonoservo.diagrams.tracker_bench import Sample, Sink, Tracked, TrackerBench
from sonoservo.diagrams.trackers.registry import TRACKERS
from sonoservo.diagrams.trackers.tracker_parts import STARTS, TrackerParameters
from sonoservo.systems.display.console.readings import tip_error
from sonoservo.systems.evaluation.explanation.explained_volume import clear_explanations
from sonoservo.systems.evaluation.labels import LABELS, recording_labels
from sonoservo.systems.evaluation.log import columns, write_log
from sonoservo.systems.evaluation.metrics import summarize
from sonoservo.systems.evaluation.reports.plots import ERRORS_CAPTION, plot_errors
from sonoservo.systems.evaluation.reports.report import Story
from sonoservo.systems.evaluation.reports.track_plots import (
    PLANES_CAPTION,
    TIP_CAPTION,
    VolumePictures,
    picture_planes,
    plot_planes,
    plot_tip,
)
from sonoservo.systems.evaluation.reports.verdict import found_words, pose_lines, recording_verdict
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.evaluation.run_logger import visible_length
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import suggest
from sonoservo.systems.files.writing import Unwritten, claim_folder, write_atomically, write_json
from sonoservo.systems.recording.side_files import TRUTH, Truth, read_truth, side_path
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.volume import Volume

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console

_PICTURES = 6  # Number of volumes of a recording that the report shows


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class TrackedRecording(RunResult):
    """Results of tracking in a recording.

    `estimates` are in W, `times` in s and lengths of the needle `in_view` in m, one for each
    volume; `rows` are those of ``estimates.csv``, in the file's own LPS in mm. The log is like that
    of a run, with the truth beside the recording, if any.
    """

    estimates: list[NeedleEstimate]
    rows: list[dict[str, Any]]
    times: Sequence[float] = ()
    in_view: Sequence[float] = ()

    def plot(self) -> Figure:
        """Return the plot of the estimated tip, which a notebook shows, if there is one."""
        if "tip.png" not in self.plots:
            raise ValueError("no volume was tracked, so there is nothing to plot")
        return self.plots["tip.png"][1]

    @property
    def found(self) -> str:
        """When a needle was found, how often it was tracked and where its tip was last.

        With the truth beside the recording, it is what that says of it.
        """
        if self.summary["truth"]:
            return str(self.verdict)
        lengths = [each for each in self.in_view if np.isfinite(each)]
        beside = ", outside what the volumes show" if lengths and lengths[-1] == 0 else ""
        found = f"{found_words(self.summary)}{beside}."
        return " ".join([found, *pose_lines(self.summary)])

    def __str__(self) -> str:
        return table_text(mode_table(self.summary))


def tracker_parameters(
    tracker: str = "chatelain2013",
    *,
    order: int = 2,
    start: str = "search",
    beam_width: float | None = None,
    echo_offset: float | None = None,
) -> TrackerParameters:
    """Return the parameters of one of the `TRACKERS` for recordings, or a ConfigurationError.

    The order is 2 for a straight needle, 3 for a bent one. "search" finds a needle that is pushed
    in, "anywhere" one in the whole volume, from the first on. The widths that the user knows are in
    m.
    """
    trackers = {each.kind: each for each in TRACKERS}
    if tracker not in trackers:
        raise ConfigurationError(
            f"unknown tracker {tracker!r}; {suggest(tracker, trackers)}; module:factory names one "
            "of your own"
        )
    if start not in STARTS:
        raise ConfigurationError(f"start: {start!r}; {suggest(start, STARTS)}")
    with refusing_values():
        own = trackers[tracker](order=order)
        return own.knowing(start=start, beam_width=beam_width, echo_offset=echo_offset)


def make_bench(
    settings: Mapping[str, Any],
    parameters: TrackerParameters | None,
    seed: int | None,
    correct_poses: bool,
    own: OwnTracker | None = None,
    **options: Any,
) -> TrackerBench:
    """Return the bench of a tracker; its seed is by default the recorder's, or else 0."""
    if own is not None:
        if correct_poses:
            raise ConfigurationError("correct_poses: not possible with a tracker of your own")
        tracker = require_tracker(as_system(own, period=1.0))
        assert tracker is not None
        return TrackerBench(tracker, **options)
    seed = int(settings.get("tracker_seed", 0)) if seed is None else seed
    made = MakeNeedleTracker(
        parameters=parameters, period=1.0, seed=seed, correct_poses=correct_poses
    )
    return TrackerBench(made, **options)


def track_recording(
    recording: Opened,
    *,
    parameters: TrackerParameters | None = None,
    tracker: OwnTracker | None = None,
    seed: int | None = None,
    real_time: bool = False,
    console: "Console | None" = None,
    out: Path | None = None,
    explain: bool = False,
    correct_poses: bool = False,
    command: str = "",
    after_volume: Callable[[int, NeedleEstimate], None] | None = None,
) -> TrackedRecording:
    """Track a needle through a recording, to its end or until interrupted from the keyboard.

    With the run's tracker, a recording made by `run` gives bit for bit the estimates of that run.
    Ground truth beside a recording is used for comparison only, never for tracking.

    Parameters
    ----------
    recording
        Recording to track in.
    parameters
        Parameters of the tracker, whose class selects it.
    tracker
        Tracker of your own in its place; see `run`.
    seed
        Seed of every random choice; by default the recorder's, or else 0.
    real_time
        Whether to limit the pace to that of the acquisition.
    console
        Console that shows and controls the tracking, if any.
    out
        Folder for estimates.csv, estimates.json, summary.json, log.npz, plots and report.html; None
        writes nothing.
    explain
        Whether to keep, in the folder's subfolder ``explanation``, what the tracker looked at
        around a loss; see `ExplanationRecorder`.
    correct_poses
        Whether to estimate the delay and the calibration of the poses, and to correct both; see
        `PoseCorrector`. The tissue must stand still.
    command
        Command that repeats the tracking, for the report.
    after_volume
        Function called after every volume with its number and the estimate.

    Raises
    ------
    ConfigurationError
        If the recording, or the truth beside it, is damaged, or there is no folder for what is to
        be explained.
    """
    if explain and out is None:
        raise ConfigurationError("explain: there is no folder to keep explanations in; give out")
    truth_path = side_path(recording.path, TRUTH)
    truth = read_truth(truth_path) if truth_path.is_file() else None
    motion = recording[0].motion
    times: list[float] = []
    in_view: list[float] = []
    estimates: list[NeedleEstimate] = []
    rows: list[dict[str, Any]] = []
    pictures: list[VolumePictures] = []
    modes = ModeCount(parameters)
    pictured = set(np.linspace(0, len(recording) - 1, _PICTURES).round().astype(int).tolist())

    def note(tracked: Tracked) -> None:
        times.append(tracked.volume.time)
        in_view.append(length_in_view(tracked.volume, tracked.estimate))
        estimates.append(tracked.estimate)
        rows.append(estimate_row(tracked, posed=recording.posed))
        if tracked.number in pictured:
            planes = picture_planes(tracked.volume, tracked.estimate.mode, tracked.estimate.curve)
            pictures.append(planes)

    sinks: list[Sink] = [note, modes]
    if after_volume is not None:
        sinks.append(lambda tracked: after_volume(tracked.number, tracked.estimate))
    if console is not None:
        sinks.append(_shown(console, truth, real_time))
    if correct_poses and not recording.posed:
        raise ConfigurationError(f"{recording.path}: --correct-poses: no poses are used")
    if out is not None and out.resolve() == recording.path.resolve():
        raise ConfigurationError(f"--out: {out} holds the volumes; results need another folder")
    with claim_folder(out):
        if out is not None:
            clear_explanations(out)
        bench = make_bench(
            recording.settings,
            parameters,
            seed,
            correct_poses,
            tracker,
            geometry=motion.geometry if motion else None,
            explain=out if explain else None,
        )
        started = time.perf_counter()
        beside = _Truth(truth, bench) if truth is not None else None
        failure: ConfigurationError | None = None
        try:
            ended = bench.run(_samples(recording, beside, real_time and console is None), sinks)
        except ConfigurationError as error:  # what was tracked before is kept
            if not rows:
                raise
            ended, failure = False, error
        summary = {
            "scenario": recording.path.name,
            "version": version("sonoservo"),
            "interrupted": not ended,
            "wall_s": time.perf_counter() - started,
            "skipped": recording.skipped,
            "poses": recording.posed,
            "frame": recording.frame,
            "truth": truth is not None,
            **modes.figures(),
        }
        log = bench.log() if beside is None else beside.log()
        figures = summarize(log, reader=modes.reader)
        kept = ("detection", "tracking", "success", "compute_ms") if truth else ("compute_ms",)
        summary |= {name: figures[name] for name in kept}
        if correct_poses:
            summary["pose_errors"] = pose_error_figures(bench.evaluate("pose_errors"))
        unwritten = Unwritten()
        plots: dict[str, tuple[str, Figure]] = {}
        if rows:
            plots["planes.png"] = PLANES_CAPTION, plot_planes(pictures)
            if any(estimates):
                p_LTip = 1e-3 * np.array(
                    [[row[f"tip_{axis}_mm"] for axis in "lps"] for row in rows]
                )
                tip = plot_tip(np.array(times), estimates, p_LTip, np.array(in_view))
                plots["tip.png"] = TIP_CAPTION, tip
            if truth is not None:
                plots["errors.png"] = ERRORS_CAPTION, plot_errors(log)
        result = TrackedRecording(
            summary, log, recording_labels(summary["modes"]) | LABELS, plots=plots,
            verdict=recording_verdict(summary), estimates=estimates, rows=rows, times=times,
            in_view=in_view,
        )  # fmt: skip
        if out is not None:
            with unwritten.collect():
                write_json(out / "summary.json", summary)
                write_atomically(out / "estimates.csv", estimates_csv(rows))
                write_json(out / "estimates.json", rows)
                write_log(out / "log.npz", log)
            if rows:
                result.write_report(out, unwritten, Story(command=command))
    return replace(result, failure=failure or unwritten.failure)


def length_in_view(volume: Volume, estimate: NeedleEstimate) -> float:
    """Return the length in m of the estimated needle that a volume shows; NaN without one."""
    if estimate.curve is None:
        return float("nan")
    points = volume.to_probe(estimate.curve.position(np.linspace(0, 1, 101)))
    if volume.motion is not None:
        return visible_length(Needle(points, 1e-3), volume.motion.geometry)
    return float(estimate.curve.chord * volume.sees(points).mean())


class _Truth:
    """Truth beside a recording, which goes to the log at its own times, as that of a run does."""

    def __init__(self, truth: Truth, bench: TrackerBench) -> None:
        self._truth, self._bench = truth, bench
        self._next = 0

    def log_until(self, time: float) -> None:
        """Log the truth since the last call up to a time in s."""
        truth, first = self._truth, self._next
        self._next = int(np.searchsorted(truth.times, time))
        for number in range(first, self._next):
            observed: dict[str, Any] = {
                "X_WT": RigidTransform(),
                "needle": truth.needles[number],
                "contact_force": [truth.contact_force[number]],
            }
            if truth.poses is not None:
                observed["true_X_WP"] = truth.poses[number]
            self._bench.observe(float(truth.times[number]), observed)

    def log(self) -> RunLog:
        """Return the bench's log with the samples of the truth, without those at volumes."""
        self.log_until(np.inf)
        log = self._bench.log()
        known = np.isin(log.time, self._truth.times)
        samples = (name for name, each in columns(RunLog).items() if each.shape[:1] == ("n",))
        return replace(log, **{name: getattr(log, name)[known] for name in samples})


def _samples(recording: Opened, truth: "_Truth | None", real_time: bool) -> Iterator[Sample]:
    """Yield the volumes of a recording with the truth beside it, at its own pace if so wished."""
    started = time.perf_counter()
    for number in range(len(recording)):
        began = time.perf_counter()
        volume = recording[number]
        read = time.perf_counter()
        if real_time:
            ahead = recording.times[number] - recording.times[0] - (read - started)
            time.sleep(max(0.0, ahead))
        if truth is not None:
            truth.log_until(volume.time)
        yield Sample(volume, recording.X_WL(number), read_s=read - began)


def _shown(console: "Console", truth: Truth | None, real_time: bool) -> Sink:
    """Return a sink that shows each volume beside the truth, and holds the pace of the console."""
    pacer = Pacer(console, speed=float(real_time), keeps_speed=True)

    def show(tracked: Tracked) -> None:
        volume, estimate, true = tracked.volume, tracked.estimate, {}
        if truth is not None:
            sample = truth.at(volume.time)
            around = range(max(sample - 9, 0), min(sample + 10, len(truth.times)))
            tips = [(truth.times[k], truth.needles[k].tip) for k in around if truth.needles[k]]
            true = {
                "error": tip_error(estimate, tips),
                "force": float(truth.contact_force[sample]),
            }
        console.show(volume, estimate, tracked.number + 1, **true)
        pacer.wait(volume.time)

    return show
