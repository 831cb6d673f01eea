"""A scenario brought to life: the loop of station, hand, scanner, tracker and controller."""

import time
from collections.abc import Callable, Container, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort, System

from sonoservo.diagrams.needle_tracker import MakeNeedleTracker
from sonoservo.diagrams.probe_controller import MakeProbeController
from sonoservo.diagrams.scenario import Scenario
from sonoservo.diagrams.scenario_insertion import check_entry, check_followed, make_insertion
from sonoservo.diagrams.seeds import draw_seeds
from sonoservo.diagrams.station import MakeStation
from sonoservo.systems.control.controller_schedule import ControllerSchedule
from sonoservo.systems.control.scheduled_settings import ScheduledSettings
from sonoservo.systems.display.monitor.scanner_monitor import ScannerMonitor
from sonoservo.systems.display.world.world_view import WorldView, WorldViewParameters
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.evaluation.run_logger import RunLogger
from sonoservo.systems.needle.hand import Hand
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.recording.volume_recorder import VolumeRecorder
from sonoservo.systems.robot.phantom import PhantomMotion
from sonoservo.systems.robot.phantom_motion import phantom_trajectory
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.ultrasound.imaging import sweep_geometry
from sonoservo.systems.ultrasound.scan_converter import ScanConverter
from sonoservo.systems.ultrasound.simulation.scanner import Scanner
from sonoservo.systems.ultrasound.simulation.tissue import load_tissue
from sonoservo.systems.ultrasound.transducer import load_transducer

if TYPE_CHECKING:
    from sonoservo.systems.display.monitor.monitor import Monitor

_INSTANT = 1e-6
"""Time in s between an event and what is looked at just before or after it."""


class Experiment:
    """A scenario as one diagram, and its simulation.

    .. pydrake_system::

        name: (the scenario's)

    The subsystems are station, scanner, scan_converter, needle_tracker, probe_controller,
    run_logger, the sources and, if wanted, world_view, scanner_monitor and volume_recorder. Every
    one of their inputs is connected to the output that has the same name.

    Parameters
    ----------
    scenario
        What is to happen.
    meshcat
        Where to draw the world, if anywhere.
    sources
        What moves needle and phantom and sets the controller, by name: systems with the outputs
        needle, phantom_command, gain and force_target. By default phantom_motion, hand and
        controller_settings, which do what the scenario says.
    tracker
        In place of the scenario's: a system with the input volume and the output estimate; the log
        keeps its outputs measurement and detection too, if it has them. `tracker_events` tells when
        it should look.
    monitor
        Where to show the volumes, if anywhere.
    film
        Whether to keep the slices for a replay.
    record
        Where to record the volumes, if anywhere: ``NAME.seq.nrrd``. Call `close` at the end.
    record_sweeps
        Whether to record the sweeps too.
    observers
        Systems without outputs that look on, by name, such as senders of a live connection;
        `observer_events` tells when they should look.

    Raises
    ------
    ValueError
        If the scenario cannot be carried out; the message names the field.
    """

    def __init__(
        self,
        scenario: Scenario,
        meshcat: Meshcat | None = None,
        *,
        sources: Mapping[str, System] | None = None,
        tracker: System | None = None,
        monitor: "Monitor | None" = None,
        film: bool = True,
        record: Path | None = None,
        record_sweeps: bool = False,
        observers: Mapping[str, System] | None = None,
    ) -> None:
        self.scenario = scenario
        seeds = draw_seeds(scenario)
        transducer = load_transducer(scenario.transducer)
        tissue = replace(load_tissue(scenario.phantom), seed=seeds.tissue)
        geometry = sweep_geometry(transducer, scenario.imaging)
        insertion = make_insertion(scenario)
        check_entry(scenario, tissue.size)
        if scenario.controller.visual_servo.gain > 0:
            check_followed(scenario, insertion)
        require(
            scenario.processing_time < geometry.period,
            "processing_time",
            scenario.processing_time,
            f"below the {geometry.period:.3f} s of a sweep",
        )
        events = tracker_events(scenario)
        self._volume_period, self._first_volume = events["period"], events["offset"]

        self.station = MakeStation(
            parameters=scenario.station,
            phantom_size=tissue.size,
            seed=seeds.wrist,
            meshcat=meshcat,
        )
        self.scanner = Scanner(
            transducer=transducer,
            imaging=scenario.imaging,
            tissue=tissue,
            parameters=scenario.scanner,
            seed=seeds.noise,
        )
        self.scan_converter = ScanConverter(geometry=geometry, parameters=scenario.scan_conversion)
        self.needle_tracker = tracker or MakeNeedleTracker(
            parameters=scenario.tracker,
            period=self._volume_period,
            offset=self._first_volume,
            dynamic_range_db=scenario.imaging.dynamic_range_db,
            seed=seeds.tracker,
        )
        self.probe_controller = MakeProbeController(parameters=scenario.controller)
        self.run_logger = RunLogger(
            volume_period=self._volume_period,
            volume_offset=self._first_volume + 2 * _INSTANT,
            geometry=geometry,
        )
        systems: dict[str, System] = {
            "station": self.station,
            **(_planned_sources(scenario, insertion) if sources is None else sources),
            "scanner": self.scanner,
            "scan_converter": self.scan_converter,
            "needle_tracker": self.needle_tracker,
            "probe_controller": self.probe_controller,
            "run_logger": self.run_logger,
        }
        if meshcat is not None:
            frames = int(scenario.duration / self._volume_period) + 1 if film else 0
            systems["world_view"] = WorldView(
                meshcat=meshcat, parameters=WorldViewParameters(film_frames=frames)
            )
        if monitor is not None:
            systems["scanner_monitor"] = ScannerMonitor(
                monitor=monitor,
                period=self._volume_period,
                offset=self._first_volume + 2 * _INSTANT,
            )
        self._recorder: VolumeRecorder | None = None
        if record is not None:
            self._recorder = systems["volume_recorder"] = VolumeRecorder(
                path=record,
                settings=recording_settings(scenario),
                sweeps=record_sweeps,
                period=self._volume_period,
                offset=self._first_volume + 2 * _INSTANT,
                truth_period=geometry.frame_period,
            )
        systems |= observers or {}
        builder = DiagramBuilder()
        for name, system in systems.items():
            builder.AddNamedSystem(name, system)
        connect_by_name(builder, list(systems.values()), optional=("measurement", "detection"))
        self.diagram = builder.Build()
        self.diagram.set_name(scenario.name)
        self._simulator = Simulator(self.diagram)

    def run(
        self,
        after_volume: Callable[[float, NeedleEstimate], None] | None = None,
        real_time: bool = False,
    ) -> None:
        """Simulate the whole scenario.

        Parameters
        ----------
        after_volume
            Called after every volume, with the simulated time in s and the estimate.
        real_time
            Whether to go no faster than real time.
        """
        self.start(real_time=real_time)
        self.advance(self.scenario.duration, after_volume)

    def start(self, *, real_time: bool = False) -> None:
        """Begin at time zero, also anew after a run: then everything is as it was before it.

        Parameters
        ----------
        real_time
            Whether to go no faster than real time.
        """
        simulator = self._simulator
        # A context of its own: a plant keeps its last contact forces in one that is only reset.
        simulator.reset_context(self.diagram.CreateDefaultContext())
        self._compute: dict[str, list[float]] = {"render": [], "convert": [], "track": []}
        self._due = self._first_volume
        simulator.set_target_realtime_rate(1.0 if real_time else 0.0)
        simulator.Initialize()

    def advance(
        self, time: float, after_volume: Callable[[float, NeedleEstimate], None] | None = None
    ) -> None:
        """Simulate up to a time in s; `start` comes first, and `run` describes the other."""
        while self._due < time:
            self._simulator.AdvanceTo(self._due - _INSTANT)
            self._make_volume(self._due)
            self._due += self._volume_period
            if after_volume is not None:
                after_volume(self.time, self._evaluate(self.needle_tracker, "estimate"))
        self._simulator.AdvanceTo(max(time, self.time))

    def forgive_delay(self) -> None:
        """Go on at real time from here, without making up for time that was lost."""
        self._simulator.ResetStatistics()

    def close(self) -> None:
        """Give a recording its final name."""
        if self._recorder is not None:
            self._recorder.close()

    def context_of(self, system: System) -> Context:
        """Return the context of one of the subsystems, as it is now."""
        return system.GetMyContextFromRoot(self._simulator.get_context())

    @property
    def time(self) -> float:
        """Simulated time so far, in s."""
        return self._simulator.get_context().get_time()

    def log(self) -> RunLog:
        """Return what has been logged so far."""
        return self.run_logger.log(compute=self._compute)

    def _make_volume(self, due: float) -> None:
        """Make the volume and the estimate that are due, and note how long each takes.

        The ports are evaluated just before the tracker asks for them; it finds them in the cache.
        In the instant of the tracker's event there is at the most one step of the plant besides.
        """
        clock = [time.perf_counter()]
        for system, port in ((self.scanner, "sweep"), (self.scan_converter, "volume")):
            self._evaluate(system, port)
            clock.append(time.perf_counter())
        self._simulator.AdvanceTo(due + _INSTANT)
        clock.append(time.perf_counter())
        for name, seconds in zip(self._compute, np.diff(clock), strict=True):
            self._compute[name].append(float(seconds))

    def _evaluate(self, system: System, port: str) -> Any:
        return system.GetOutputPort(port).Eval(self.context_of(system))


def _planned_sources(scenario: Scenario, insertion: Insertion) -> dict[str, System]:
    schedule = ControllerSchedule(scenario.controller.settings, tuple(scenario.controller_changes))
    return {
        "phantom_motion": PhantomMotion(
            trajectory=phantom_trajectory(scenario.phantom_motion, scenario.station.X_WT)
        ),
        "hand": Hand(insertion=insertion),
        "controller_settings": ScheduledSettings(schedule=schedule),
    }


def tracker_events(scenario: Scenario) -> dict[str, float]:
    """When a tracker should look for a new volume: the period and the offset of its events, in s.

    Raises
    ------
    ValueError
        If the scenario's transducer or imaging is not possible.
    """
    period = sweep_geometry(load_transducer(scenario.transducer), scenario.imaging).period
    return {"period": period, "offset": period + scenario.processing_time}


def observer_events(scenario: Scenario) -> dict[str, float]:
    """When to look for a new volume and its estimate: period and offset of the events, in s."""
    events = tracker_events(scenario)
    return {"period": events["period"], "offset": events["offset"] + 2 * _INSTANT}


def recording_settings(scenario: Scenario) -> dict[str, Any]:
    """Return what a tracker of a scenario's volumes has to know besides them."""
    return {
        "dynamic_range_db": scenario.imaging.dynamic_range_db,
        "tracker_seed": draw_seeds(scenario).tracker,
    }


def connect_by_name(
    builder: DiagramBuilder, systems: list[System], optional: Container[str] = ()
) -> None:
    """Connect every input port to the output port that has its name; optional ones if there is."""
    outputs: dict[str, OutputPort] = {}
    for system in systems:
        for index in range(system.num_output_ports()):
            port = system.get_output_port(index)
            outputs[port.get_name()] = port
    for system in systems:
        for index in range(system.num_input_ports()):
            port = system.get_input_port(index)
            if port.get_name() in outputs or port.get_name() not in optional:
                builder.Connect(outputs[port.get_name()], port)
