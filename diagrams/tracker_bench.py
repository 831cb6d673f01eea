"""Bench of a tracker: volumes from any source go through the tracker to any number of sinks."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, Diagram, System

from sonoservo.diagrams.needle_tracker import MakeNeedleTracker
from sonoservo.diagrams.trackers.tracker_parts import TrackerParameters
from sonoservo.systems.calibration.pose_corrector import HandEyeCorrector
from sonoservo.systems.evaluation.explanation.explained_volume import ExplanationRecorder
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.evaluation.run_logger import RunLogger
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.ports import DiagramBuilder
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.signals.volume import Volume

OBSERVED = (
    "X_WP", "true_X_WP", "X_WT", "needle", "motion_record", "contact_force", "planar_velocity"
)  # fmt: skip
"""Inputs of a bench that only its log reads; those of the truth never reach the tracker."""

_LOGGED = ("estimate", "measurement", "detection")


def MakeTrackerBench(
    *,
    tracker: System,
    observed: Sequence[str] = OBSERVED,
    geometry: SweepGeometry | None = None,
    explain: Path | None = None,
    period: float = 1.0,
    offset: float = 0.0,
) -> Diagram:
    """Make a diagram of a tracker and its log.

    .. pydrake_system::

        name: needle_tracker
        input_ports:
        - volume
        - X_WP (and the other inputs of the log, `OBSERVED`)

    The tracker reads the volume alone. If it corrects poses, the log holds the probe's measured
    pose with the hand-eye error taken out.

    Parameters
    ----------
    tracker, observed
        Tracker with the input volume and the output estimate, and the inputs of its log.
    geometry
        Geometry of the sweeps, which bounds the part of the needle in view.
    explain
        Folder of the run in which the tracker's searches around a loss are kept, if any.
    period, offset
        Period and offset in s of the checks for a new estimate: shortly after the tracker's events.
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("needle_tracker", tracker)
    logger = builder.AddNamedSystem(
        "run_logger", RunLogger(volume_period=period, volume_offset=offset, geometry=geometry)
    )
    builder.ExportInput(tracker.GetInputPort("volume"), "volume")
    _connect(builder, tracker, logger, _LOGGED)
    if explain is not None:
        if not tracker.HasOutputPort("explanation"):
            raise ConfigurationError("explain: this tracker has no output 'explanation'")
        recorder = builder.AddNamedSystem(
            "explanation_recorder",
            ExplanationRecorder(folder=explain, period=period, offset=offset),
        )
        _connect(
            builder,
            tracker,
            recorder,
            ("estimate", "explanation", "lines_explanation", "detection"),
        )
        builder.ConnectInput("volume", recorder.GetInputPort("volume"))
    ports = {name: logger.GetInputPort(name) for name in observed}
    if tracker.HasOutputPort("pose_errors") and "X_WP" in ports:
        corrector = builder.AddNamedSystem("hand_eye_corrector", HandEyeCorrector())
        _connect(builder, tracker, corrector, ("pose_errors",))
        builder.Connect(corrector.GetOutputPort("corrected_X_WP"), ports["X_WP"])
        ports["X_WP"] = corrector.GetInputPort("X_WP")
    for name, port in ports.items():
        builder.ExportInput(port, name)
    diagram = builder.Build()
    diagram.set_name(tracker.get_name())
    return diagram


def _connect(builder: DiagramBuilder, source: System, target: System, names: Sequence[str]) -> None:
    for name in names:
        if source.HasOutputPort(name):
            builder.Connect(source.GetOutputPort(name), target.GetInputPort(name))


def log_of(bench: Diagram, context: Context, compute: Mapping[str, Any] | None = None) -> RunLog:
    """Return the log of a bench in a context of its own; ``compute`` is that of `RunLogger.log`."""
    logger = cast(RunLogger, bench.GetSubsystemByName("run_logger"))
    return logger.log(bench.GetSubsystemContext(logger, context), compute=compute)


@dataclass(frozen=True, eq=False)
class Sample:
    """A volume as a source delivers it."""

    volume: Volume
    X_WL: RigidTransform | None = None  # of the source's frame L; None for P
    observed: Mapping[str, Any] = field(default_factory=dict)  # truth for the log, by port
    read_s: float = 0.0  # time that the source needed, in s


@dataclass(frozen=True, eq=False)
class Tracked:
    """A volume that has been tracked, as a sink receives it."""

    number: int  # from 0
    sample: Sample
    estimate: NeedleEstimate
    X_WL: RigidTransform  # pose of the source's frame L, corrected as the volume's poses are
    track_s: float  # time that the tracker needed, in s

    @property
    def volume(self) -> Volume:
        """The volume itself."""
        return self.sample.volume


Sink = Callable[[Tracked], None]
"""Function that receives every tracked volume: a table, a console, a sender, a progress bar."""


class TrackerBench:
    """A tracker outside a simulation: one loop from a source of volumes to sinks.

    Parameters
    ----------
    tracker
        Any tracker, such as one from `MakeNeedleTracker`.
    logged
        Whether to keep a log; without one, a connection may run for days in constant memory.
    geometry, explain
        See `MakeTrackerBench`.
    """

    def __init__(
        self,
        tracker: System,
        *,
        logged: bool = True,
        geometry: SweepGeometry | None = None,
        explain: Path | None = None,
    ) -> None:
        self._tracker, self._logged = tracker, logged
        if logged:
            self._bench: System = MakeTrackerBench(
                tracker=tracker, geometry=geometry, explain=explain
            )
        else:
            self._bench = tracker
        self._context = self._bench.CreateDefaultContext()
        self._own = tracker.GetMyContextFromRoot(self._context)
        self._compute: dict[str, list[float]] = {"read": [], "track": []}
        self._count = 0

    def track(self, volume: Volume, observed: Mapping[str, Any] | None = None) -> NeedleEstimate:
        """Give the tracker its next volume, and the log what was observed; return the estimate."""
        self._fix("volume", volume)
        if self._logged:
            self._context.SetTime(volume.time)
            for name, value in {"X_WP": volume.X_WP, **(observed or {})}.items():
                self._fix(name, value)
        # Outside a simulation no event is due, so one is forced.
        self._bench.ExecuteForcedEvents(self._context)
        estimate: NeedleEstimate = self.evaluate("estimate")
        checks = self._tracker.HasOutputPort("volume_check")
        refusal = self.evaluate("volume_check").reason if checks else ""
        return replace(estimate, reason=refusal) if refusal else estimate

    def observe(self, time: float, observed: Mapping[str, Any]) -> None:
        """Log what was observed at a time in s between two volumes, or after the last one."""
        self._context.SetTime(time)
        for name, value in observed.items():
            self._fix(name, value)
        logger = cast(Diagram, self._bench).GetSubsystemByName("run_logger")
        logger.ForcedPublish(logger.GetMyContextFromRoot(self._context))

    def _fix(self, name: str, value: Any) -> None:
        port = self._bench.GetInputPort(name)
        if isinstance(value, RigidTransform):
            value = Value(value)
        elif not isinstance(value, list):
            value = Value[object](value)
        port.FixValue(self._context, value)

    def run(self, source: Iterable[Sample], sinks: Sequence[Sink] = ()) -> bool:
        """Track the volumes of a source, and hand each result to the sinks in order."""
        try:
            for sample in source:
                began = time.perf_counter()
                estimate = self.track(sample.volume, sample.observed)
                X_WL = self.corrected(sample.volume, sample.X_WL or sample.volume.X_WP)
                track_s = time.perf_counter() - began
                tracked = Tracked(self._count, sample, estimate, X_WL, track_s)
                self._count += 1
                if self._logged:
                    self._compute["read"].append(sample.read_s)
                    self._compute["track"].append(track_s)
                for sink in sinks:
                    sink(tracked)
        except KeyboardInterrupt:
            return False
        return True

    def log(self) -> RunLog:
        """Return the log so far."""
        return log_of(cast(Diagram, self._bench), self._context, self._compute)

    def evaluate(self, port: str) -> Any:
        """Return the present value of one of the tracker's outputs."""
        return self._tracker.GetOutputPort(port).Eval(self._own)

    @property
    def corrects_poses(self) -> bool:
        """Whether the tracker corrects the poses of its volumes."""
        return bool(self._tracker.HasOutputPort("corrected_volume"))

    def corrected(self, volume: Volume, X_WL: RigidTransform) -> RigidTransform:
        """Return the pose of a frame L of the newest volume, corrected as its poses are."""
        if not self.corrects_poses:
            return X_WL
        corrected: Volume = self.evaluate("corrected_volume")
        return corrected.X_WP.multiply(volume.X_WP.inverse()).multiply(X_WL)


def track(
    volumes: Iterable[Volume],
    *,
    parameters: TrackerParameters | None = None,
    seed: int = 0,
) -> Iterator[NeedleEstimate]:
    """Track a needle through volumes, one by one, as in a simulation that delivers the same.

    Parameters
    ----------
    volumes
        Volumes from any source.
    parameters
        Parameters of the tracker.
    seed
        Seed of every random choice.

    Returns
    -------
    An iterator over the estimates, one after each volume.
    """
    if isinstance(volumes, str | Path):
        raise ConfigurationError(
            f"volumes: {str(volumes)!r} is one path; expected Volume objects. "
            "track_recording(Recording(path)) tracks the volumes of a file"
        )
    if not isinstance(parameters, TrackerParameters | None):
        raise ConfigurationError(
            f"parameters: a value of type {type(parameters).__name__}; expected those of a "
            'tracker, such as tracker_parameters(start="anywhere")'
        )
    tracker = MakeNeedleTracker(parameters=parameters, period=1.0, seed=seed)
    return map(TrackerBench(tracker, logged=False).track, volumes)
