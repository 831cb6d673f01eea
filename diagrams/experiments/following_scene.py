"""Surroundings of a run of following: its scene, the times of its volumes, and its sources."""

from typing import TYPE_CHECKING, Any

from pydrake.systems.framework import System

from sonoservo.diagrams.experiments.experiment import INSTANT
from sonoservo.diagrams.experiments.following_insertion import (
    check_beside_probe,
    check_entry,
    make_insertion,
)
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.probe_controller import ProbeControllerParameters
from sonoservo.diagrams.scenario import Scenario, draw_seeds, require_scenario
from sonoservo.diagrams.scene import Scene
from sonoservo.systems.control.operator_settings import OperatorSettings
from sonoservo.systems.control.scheduled_settings import ScheduledSettings
from sonoservo.systems.display.console.controls import Control, controller_controls
from sonoservo.systems.display.console.operator_panel import OperatorPanel
from sonoservo.systems.needle.hand import Hand
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.robot.phantom import PhantomMotion
from sonoservo.systems.robot.phantom_motion import phantom_trajectory
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.imaging import sweep_geometry
from sonoservo.systems.ultrasound.scan_converter import ScanConverter
from sonoservo.systems.ultrasound.transducer import load_transducer

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console


def make_scene(scenario: FollowingScenario) -> Scene:
    """Return the scene of a scenario, with the poses of probe and phantom as its inputs."""
    scene = Scene.of(scenario, make_insertion(scenario), reaction=scenario.tissue_reaction)
    check_entry(scenario, scene.tissue.surface)
    check_beside_probe(scenario, scene.insertion, scene.tissue.surface)
    return scene


def imaging_systems(scenario: FollowingScenario, scene: Scene) -> dict[str, System]:
    """Return the scanner and the scan converter, from the probe's poses to its volumes."""
    busy = scenario.processing_time if is_irregular(scenario, scene.geometry) else 0.0
    return {
        "scanner": scene.scanner(busy),
        "scan_converter": ScanConverter(
            geometry=scene.geometry, parameters=scenario.scan_conversion
        ),
    }


def is_irregular(scenario: FollowingScenario, geometry: SweepGeometry) -> bool:
    """Return True if estimates do not come a fixed time after the end of each sweep."""
    parameters = scenario.scanner
    ahead = parameters.clock.offset > 0 or parameters.clock.drift > 0
    busy = scenario.processing_time >= geometry.period
    return busy or ahead or parameters.connection.lateness > 0


def tracker_events(scenario: Scenario) -> dict[str, float]:
    """Return the period and the offset in s of the events at which a tracker looks for a volume.

    If volumes come late, or the tracker needs longer than a sweep takes, it looks after every
    frame; the scanner then withholds a volume for the processing time.
    """
    scenario = require_scenario(scenario, FollowingScenario)
    geometry = sweep_geometry(load_transducer(scenario.probe), scenario.imaging)
    if is_irregular(scenario, geometry):
        return {"period": geometry.frame_period, "offset": geometry.period + 10 * INSTANT}
    return {"period": geometry.period, "offset": geometry.period + scenario.processing_time}


def observer_events(scenario: Scenario) -> dict[str, float]:
    """Return the period and offset in s at which to look for a new volume and its estimate."""
    events = tracker_events(scenario)
    return {"period": events["period"], "offset": events["offset"] + 2 * INSTANT}


def recording_settings(scenario: FollowingScenario) -> dict[str, Any]:
    """Return the settings that a tracker of a scenario's recorded volumes needs."""
    return {"tracker_seed": draw_seeds(scenario).tracker}


def planned_sources(
    scenario: FollowingScenario, insertion: Insertion, console: "Console | None" = None
) -> dict[str, System]:
    """Return the sources by name; with a console, its operator_panel changes the settings."""
    schedule = scenario.controller_schedule
    settings: dict[str, System] = {"controller_settings": ScheduledSettings(schedule=schedule)}
    if console is not None:
        controls = settings_controls(scenario.controller)
        settings = {
            "operator_panel": OperatorPanel(controls=controls, inputs=console.controls),
            "controller_settings": OperatorSettings(schedule=schedule),
        }
    return {
        "phantom_motion": PhantomMotion(
            trajectory=phantom_trajectory(scenario.phantom_motion, scenario.station.X_WT)
        ),
        "hand": Hand(insertion=insertion),
        **settings,
    }


def settings_controls(controller: ProbeControllerParameters) -> list[Control]:
    """Return the sliders of a controller's gain and force."""
    start = controller.settings
    return controller_controls(
        gain=start.gain,
        force=start.force,
        min_force=controller.force.touch_force + 0.1,
        max_force=min(5.0, 0.8 * controller.guards.max_force),
    )
