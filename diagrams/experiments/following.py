"""Following: the robot finds a needle in volumes, keeps it centred and presses the probe."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from pydrake.geometry import Meshcat
from pydrake.systems.framework import System

from sonoservo.diagrams.experiments.experiment import Experiment
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.following_scene import (
    check_followed,
    imaging_systems,
    make_scene,
    observer_events,
    planned_sources,
    recording_settings,
    tracker_events,
)
from sonoservo.diagrams.needle_tracker import MakeNeedleTracker, require_tracker
from sonoservo.diagrams.probe_controller import MakeProbeController
from sonoservo.diagrams.scenario import Scenario, draw_seeds, require_scenario
from sonoservo.diagrams.station import MakeStation
from sonoservo.systems.control.controller_schedule import OperatorSettings
from sonoservo.systems.display.console.console_feed import ConsoleFeed
from sonoservo.systems.display.world.world_view import WorldView
from sonoservo.systems.evaluation.explanation.explained_volume import ExplanationRecorder
from sonoservo.systems.evaluation.metrics import summarize
from sonoservo.systems.evaluation.reports.track_plots import PictureRecorder, VolumePictures
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.evaluation.run_logger import RunLogger
from sonoservo.systems.recording.volume_recorder import VolumeRecorder
from sonoservo.systems.robot.errors.calibration import hand_eye_error
from sonoservo.systems.signals.guard_status import GuardState, GuardStatus
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.search_reason import Reader
from sonoservo.systems.ultrasound.simulation.scanner import Scanner

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console

_OBSERVERS = ("scanner", "run_logger", "world_view", "console_feed", "volume_recorder")
"""Systems that see the truth, apart from the station and the sources that produce it."""

_WRIST_ALONE = (
    "the arm reports no torques (torque_error), so nothing but the wrist's sensor tells the force"
)
"""Remark on a guard that has only one witness of the force."""


class FollowingExperiment(Experiment[FollowingScenario]):
    """Closed loop of station, hand, scanner, tracker and controller.

    .. pydrake_system::

        name: (the scenario's)

    Parameters
    ----------
    scenario
        Scenario of following.
    meshcat, console
        Meshcat that draws the world, and console that shows the run, if any.
    sources
        Systems that move needle and phantom and set the controller, by name, with the outputs
        needle, phantom_command, gain and force_target. By default, `planned_sources`.
    tracker
        System that replaces the scenario's tracker, with the input volume and the output estimate;
        outputs measurement and detection are logged too. It looks for volumes at `tracker_events`.
    film, pictures
        Whether to keep the slices for a replay, and pictures of the volumes for the report.
    record, record_sweeps
        File to which the volumes are recorded, ``NAME.seq.nrrd``, if any, and whether with the
        sweeps. Call `close` at the end.
    explain
        Folder of the run in which the tracker's searches around a loss are kept, if any.
    observers
        Systems without outputs, by name; they look for a volume at `observer_events`.
    search
        System that moves the probe while no needle is followed; see `MakeProbeController`.
    """

    scenario_class = FollowingScenario
    options = frozenset(
        {"console", "explain", "meshcat", "observers", "pictures", "record", "record_sweeps"}
        | {"tracker"}
    )
    log_class = RunLog
    reader = Reader.SCENARIO

    def __init__(
        self,
        scenario: Scenario,
        meshcat: Meshcat | None = None,
        *,
        sources: Mapping[str, System] | None = None,
        tracker: System | None = None,
        console: "Console | None" = None,
        film: bool = True,
        record: Path | None = None,
        record_sweeps: bool = False,
        explain: Path | None = None,
        pictures: bool = False,
        observers: Mapping[str, System] | None = None,
        search: System | None = None,
    ) -> None:
        scenario = require_scenario(scenario, FollowingScenario)
        seeds = draw_seeds(scenario)
        scene = make_scene(scenario)
        geometry = scene.geometry
        if scenario.controller.visual_servo.gain > 0:
            check_followed(scenario, scene.insertion, scene.tissue.surface)
        events = tracker_events(scenario)
        period, offset = events["period"], events["offset"]
        a_moment_later = observer_events(scenario)
        observers = observers or {}
        for name, system in observers.items():
            outputs = system.num_output_ports()
            require(outputs == 0, f"observers.{name}", f"{outputs} outputs", "without outputs")

        self.station = MakeStation(
            parameters=scenario.station,
            probe=scenario.probe,
            phantom=scenario.phantom,
            seed=seeds.station,
            meshcat=meshcat,
        )
        imaging = imaging_systems(scenario, scene)
        self.scanner, self.scan_converter = imaging["scanner"], imaging["scan_converter"]
        scanner = cast(Scanner, self.scanner)
        kind = type(tracker)
        self._own_tracker = f"{kind.__module__}.{kind.__qualname__}" if tracker else ""
        self.needle_tracker = require_tracker(tracker) or MakeNeedleTracker(
            parameters=scenario.tracker, period=period, offset=offset, seed=seeds.tracker
        )
        self.probe_controller = MakeProbeController(
            parameters=scenario.controller,
            arm=scenario.station.arm,
            probe=scenario.probe,
            surface=scenario.station.phantom_position,
            X_PC=hand_eye_error(scenario.station.calibration, seeds.station),
            mass_error=scenario.station.calibration.probe_mass,
            search=search,
        )
        self.run_logger = RunLogger(
            volume_period=period,
            volume_offset=a_moment_later["offset"],
            joints=self.station.GetOutputPort("joint_state").size() // 2,
            geometry=geometry,
        )
        if sources is None:
            sources = planned_sources(scenario, scene.insertion, console)
        self._settings = sources["controller_settings"]
        sources = scene.reacting(sources)
        systems: dict[str, System] = {
            "station": self.station,
            **sources,
            **imaging,
            "needle_tracker": self.needle_tracker,
            "probe_controller": self.probe_controller,
            "run_logger": self.run_logger,
        }
        if meshcat is not None:
            frames = int(scenario.duration / geometry.period) + 1 if film else 0
            systems["world_view"] = WorldView(meshcat=meshcat, film_frames=frames)
        if console is not None:
            systems["console_feed"] = ConsoleFeed(console=console, **a_moment_later)
        self._recorder: VolumeRecorder | None = None
        if record is not None:
            self._recorder = systems["volume_recorder"] = VolumeRecorder(
                path=record,
                settings=recording_settings(scenario),
                sweeps=record_sweeps,
                **a_moment_later,
            )
        self._picture_recorder: PictureRecorder | None = None
        if pictures:
            self._picture_recorder = PictureRecorder(**a_moment_later)
            systems["picture_recorder"] = self._picture_recorder
        if explain is not None:
            systems["explanation_recorder"] = ExplanationRecorder(
                folder=explain, period=period, offset=a_moment_later["offset"]
            )
        super().__init__(
            scenario,
            {**systems, **observers},
            period=period,
            offset=offset,
            stages={"render": (self.scanner, "sweep"), "convert": (self.scan_converter, "volume")},
            event="track",
            background={"render": lambda: scanner.work_s},
            optional=(
                "confirmation",
                "deformation",
                "measurement",
                "detection",
                "guard",
                "hold_reason",
                "lines",
                "lines_explanation",
                "volume_check",
            ),
            sees_truth={"station", *sources, *_OBSERVERS, *observers},
        )

    @property
    def repeatable(self) -> bool:
        """Whether the scenario alone repeats the run: not with a tracker of one's own."""
        return not self._own_tracker

    @property
    def own_tracker(self) -> str:
        """Module and class of a tracker that replaces the scenario's; empty if none does."""
        return self._own_tracker

    @property
    def estimate(self) -> NeedleEstimate:
        """Present estimate of the tracker."""
        return cast(NeedleEstimate, self.evaluate(self.needle_tracker, "estimate"))

    @property
    def status(self) -> str:
        """Why the robot is stopped or holds, or the tracker's mode and why it sees no needle."""
        if self._guard.stopped:
            return f"stopped: {self._guard.reason}"
        if hold := self.evaluate(self.probe_controller, "hold_reason"):
            return f"held: {hold}"
        estimate = self.estimate
        return f"{estimate.mode}: {estimate.reason}" if estimate.reason else str(estimate.mode)

    @property
    def _guard(self) -> GuardStatus:
        if not self.probe_controller.HasOutputPort("guard"):
            return GuardStatus(GuardState.MONITORING)
        return cast(GuardStatus, self.evaluate(self.probe_controller, "guard"))

    def log(self) -> RunLog:
        """Return the log so far."""
        return self.run_logger.log(self.context_of(self.run_logger), compute=self.compute)

    def summarize(self, log: RunLog) -> dict[str, Any]:
        """Summarise a log, see `summarize`, and add what the guard noticed as `guard.noticed`."""
        figures = summarize(log, self.force_target, self.reader)
        controller, noticed = self.probe_controller, [self._guard.remark]
        if controller.HasOutputPort("guard") and not controller.HasInputPort("external_torque"):
            noticed.append(_WRIST_ALONE)
        figures["guard"]["noticed"] = "; ".join(filter(None, noticed)) or None
        return figures

    def happened(self) -> FollowingScenario:
        """Return the scenario that repeats the run, with the changes made in the console."""
        if not isinstance(self._settings, OperatorSettings):
            return self.scenario
        changes = self._settings.schedule(self.context_of(self._settings)).changes
        return replace(self.scenario, controller_changes=list(changes))

    @property
    def pictures(self) -> list[VolumePictures]:
        """Pictures of the volumes so far; none unless they are kept."""
        if self._picture_recorder is None:
            return []
        return self._picture_recorder.pictures(self.context_of(self._picture_recorder))

    @property
    def force_target(self) -> float | None:
        """Controller's target force in N; None if it changes during the run."""
        happened = self.happened()
        changed = any(change.force is not None for change in happened.controller_changes)
        return None if changed else happened.controller.force.force

    def close(self) -> None:
        """Give a recording its final name."""
        if self._recorder is not None:
            self._recorder.close()
