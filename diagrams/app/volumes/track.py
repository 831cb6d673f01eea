"""Tracking in recorded volumes."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform

from sonoservo.diagrams.app.pages.pacer import Pacer
from sonoservo.diagrams.app.volumes.calibrate import pose_error_figures
from sonoservo.diagrams.app.volumes.estimates_table import estimate_row
from sonoservo.diagrams.app.volumes.reconstruct import ReconstructedRecording
from sonoservo.diagrams.app.volumes.tracked_recording import TrackedRecording
from sonoservo.diagrams.app.volumes.true_values import true_values
from sonoservo.diagrams.needle_tracker import MakeNeedleTracker
from sonoservo.diagrams.tracker_bench import corrected_frame
from sonoservo.diagrams.trackers.registry import TRACKERS
from sonoservo.diagrams.trackers.tracker_parts import STARTS, TrackerParameters
from sonoservo.systems.evaluation.explanation.explained_volume import clear_explanations
from sonoservo.systems.evaluation.explanation.explanation_recorder import ExplanationRecorder
from sonoservo.systems.evaluation.metrics import summarize
from sonoservo.systems.evaluation.reports.track_plots import VolumePictures, picture_planes
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.evaluation.run_logger import RunLogger
from sonoservo.systems.files.claims import claim_folder
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import suggest
from sonoservo.systems.files.writing import Unwritten
from sonoservo.systems.recording.recording import Recording
from sonoservo.systems.recording.side_files import TRUTH, Truth, read_truth, side_path
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.ports import DiagramBuilder
from sonoservo.systems.signals.search_reason import ReasonCount
from sonoservo.systems.signals.volume import Volume

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console

_PICTURES = 6
"""Number of volumes of a recording that the report shows."""


@dataclass
class _Progress:
    """Results so far."""

    times: list[float] = field(default_factory=list)
    estimates: list[NeedleEstimate] = field(default_factory=list)
    rows: list[dict[str, Any]] = field(default_factory=list)
    pictures: list[VolumePictures] = field(default_factory=list)
    compute: dict[str, list[float]] = field(default_factory=lambda: {"read": [], "track": []})


def tracker_parameters(
    tracker: str = "chatelain2013",
    *,
    order: int = 2,
    start: str = "search",
    beam_width: float | None = None,
    echo_offset: float | None = None,
) -> TrackerParameters:
    """Return the parameters of a tracker for recordings.

    Parameters
    ----------
    tracker
        Kind of one of the `TRACKERS`.
    order
        Order of the curve: 2 for a straight needle, 3 for a bent one.
    start
        "search" to find the needle when it is pushed in; "anywhere" to localize it in the whole
        volume from the first volume on, without seeing the insertion.
    beam_width, echo_offset
        Values that the user knows, in m; see `NeedleLocalizerParameters.knowing`.

    Raises
    ------
    ConfigurationError
        If a value is not allowed; the message names it.
    """
    trackers = {each.kind: each for each in TRACKERS}
    if tracker not in trackers:
        raise ConfigurationError(f"unknown tracker {tracker!r}; {suggest(tracker, trackers)}")
    if start not in STARTS:
        raise ConfigurationError(f"start: {start!r}; {suggest(start, STARTS)}")
    try:
        own = trackers[tracker](order=order)
        return own.knowing(start=start, beam_width=beam_width, echo_offset=echo_offset)
    except ValueError as error:
        raise ConfigurationError(str(error)) from error


def track_recording(
    recording: Recording | ReconstructedRecording,
    *,
    parameters: TrackerParameters | None = None,
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
    with claim_folder(out):
        return _track(
            recording, parameters, seed, real_time, console, out, explain, correct_poses, command,
            after_volume,
        )  # fmt: skip


def _track(
    recording: Recording | ReconstructedRecording,
    parameters: TrackerParameters | None,
    seed: int | None,
    real_time: bool,
    console: "Console | None",
    out: Path | None,
    explain: bool,
    correct_poses: bool,
    command: str,
    after_volume: Callable[[int, NeedleEstimate], None] | None,
) -> TrackedRecording:
    seed = int(recording.settings.get("tracker_seed", 0)) if seed is None else seed
    truth_path = side_path(recording.path, TRUTH)
    truth = read_truth(truth_path) if truth_path.is_file() else None

    tracker = MakeNeedleTracker(
        parameters=parameters, period=1.0, seed=seed, correct_poses=correct_poses
    )
    motion = recording[0].motion
    logger = RunLogger(geometry=motion.geometry if motion else None)
    builder = DiagramBuilder()
    for name, system in (("needle_tracker", tracker), ("run_logger", logger)):
        builder.AddNamedSystem(name, system)
    for port in ("estimate", "measurement", "detection"):
        if tracker.HasOutputPort(port):
            builder.Connect(tracker.GetOutputPort(port), logger.GetInputPort(port))
    builder.ExportInput(tracker.GetInputPort("volume"), "volume")
    if out is not None:
        clear_explanations(out)
    if explain and out is not None:
        if not tracker.HasOutputPort("explanation"):
            raise ConfigurationError("explain: this tracker has no output 'explanation'")
        recorder = builder.AddNamedSystem("explanation_recorder", ExplanationRecorder(folder=out))
        for port in ("estimate", "explanation", "detection"):
            builder.Connect(tracker.GetOutputPort(port), recorder.GetInputPort(port))
        builder.ConnectInput("volume", recorder.GetInputPort("volume"))
    for port in ("X_WP", "X_WT", "needle", "contact_force"):
        builder.ExportInput(logger.GetInputPort(port), port)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    estimate_port = tracker.GetOutputPort("estimate")
    tracker_context = tracker.GetMyContextFromRoot(context)

    done = _Progress()
    pacer = Pacer(console, speed=float(real_time), keeps_speed=True) if console else None
    pictured = set(np.linspace(0, len(recording) - 1, _PICTURES).round().astype(int).tolist())
    interrupted, started = False, time.perf_counter()
    try:
        for number in range(len(recording)):
            clock = [time.perf_counter()]
            volume = recording[number]
            clock.append(time.perf_counter())
            if real_time and pacer is None:
                ahead = recording.times[number] - recording.times[0] - (clock[1] - started)
                time.sleep(max(0.0, ahead))
                clock[1] = time.perf_counter()
            context.SetTime(volume.time)
            diagram.GetInputPort("volume").FixValue(context, Value[object](volume))
            diagram.GetInputPort("X_WP").FixValue(context, Value(volume.X_WP))
            if truth is not None:
                sample = truth.at(volume.time)
                diagram.GetInputPort("X_WT").FixValue(context, Value(RigidTransform()))
                needle = Value[object](truth.needles[sample])
                diagram.GetInputPort("needle").FixValue(context, needle)
                force = diagram.GetInputPort("contact_force")
                force.FixValue(context, [truth.contact_force[sample]])
            diagram.ExecuteForcedEvents(context)
            estimate: NeedleEstimate = estimate_port.Eval(tracker_context)
            X_WL = recording.X_WL(number)
            if correct_poses:
                X_WL = corrected_frame(tracker, tracker_context, volume, X_WL)
            clock.append(time.perf_counter())
            _note(done, recording, number, volume, estimate, X_WL, clock, number in pictured)
            if after_volume is not None:
                after_volume(number, estimate)
            if console is not None and pacer is not None:
                console.show(volume, estimate, number + 1, **true_values(truth, volume, estimate))
                pacer.wait(volume.time)
    except KeyboardInterrupt:
        interrupted = True
    wall = time.perf_counter() - started

    log = logger.log(
        logger.GetMyContextFromRoot(context),
        compute={name: np.array(each) for name, each in done.compute.items()},
    )
    summary = _summarize(recording, done, log, truth, interrupted, wall)
    if correct_poses:
        errors = tracker.GetOutputPort("pose_errors").Eval(tracker_context)
        summary["pose_errors"] = pose_error_figures(errors)
    unwritten = Unwritten()
    result = TrackedRecording(
        done.estimates, done.rows, summary, log, times=done.times, pictures=done.pictures
    )
    if out is not None:
        result.write(out, command, unwritten)
    return replace(result, failure=unwritten.failure)


def _note(
    done: _Progress,
    recording: Recording | ReconstructedRecording,
    number: int,
    volume: Volume,
    estimate: NeedleEstimate,
    X_WL: RigidTransform,
    clock: Sequence[float],
    pictured: bool,
) -> None:
    for name, start, stop in zip(done.compute, clock, clock[1:], strict=False):
        done.compute[name].append(stop - start)
    done.times.append(volume.time)
    done.estimates.append(estimate)
    posed = recording.posed
    done.rows.append(estimate_row(number, volume, estimate, X_WL, posed=posed))
    if pictured:
        done.pictures.append(picture_planes(volume, estimate.mode, estimate.curve))


def _summarize(
    recording: Recording | ReconstructedRecording,
    done: _Progress,
    log: RunLog,
    truth: Truth | None,
    interrupted: bool,
    wall: float,
) -> dict[str, Any]:
    modes = [str(each.mode) for each in done.estimates]
    lost = ReasonCount(each.reason for each in done.estimates if not each)
    summary: dict[str, Any] = {
        "scenario": recording.path.name,
        "version": version("sonoservo"),
        "interrupted": interrupted,
        "wall_s": wall,
        "volumes": len(modes),
        "skipped": recording.skipped,
        "poses": recording.posed,
        "truth": truth is not None,
        "modes": {mode: modes.count(mode) for mode in sorted(set(modes))},
        "reasons": lost.words,
        "advice": lost.advice if "tracking" not in modes else "",
    }
    figures = summarize(log)
    kept = ("detection", "tracking", "compute_ms") if truth is not None else ("compute_ms",)
    return summary | {name: figures[name] for name in kept}
