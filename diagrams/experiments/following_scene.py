"""Surroundings of a run of following: its scene, the times of its volumes, and its sources."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import System

from sonoservo.diagrams.assembly import load_probe_body
from sonoservo.diagrams.experiments.experiment import INSTANT
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.probe_controller import ProbeControllerParameters
from sonoservo.diagrams.scenario import Scenario, draw_seeds, require_scenario
from sonoservo.diagrams.scene import Scene
from sonoservo.diagrams.station import ProbePlacement, check_reach
from sonoservo.systems.control.controller_schedule import OperatorSettings, ScheduledSettings
from sonoservo.systems.display.console.controls import Control, OperatorPanel, controller_controls
from sonoservo.systems.needle.hand import Hand
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.needle.insertion_parameters import OUTER_DIAMETER, InsertionParameters, Push
from sonoservo.systems.robot.phantom import PhantomMotion
from sonoservo.systems.robot.phantom_motion import phantom_trajectory
from sonoservo.systems.robot.probe_body import distance_to_probe
from sonoservo.systems.signals.body_surface import BodySurface
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.imaging import sweep_geometry
from sonoservo.systems.ultrasound.scan_converter import ScanConverter
from sonoservo.systems.ultrasound.simulation.tissue import load_tissue
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


_APPROACH, _AIM_DEPTH, _ASIDE = 0.06, 0.045, 0.04
"""By default: the tip's distance from its aim at the start, depth of the aim below the probe, and
least distance of the entry from the middle of the probe, in m."""

_SETTLING = 2.0  # time from the first contact until the force has settled, in s

_INDENTATION, _SHAFT = 4e-3, 0.15
"""Indentation by a landed probe at 2 N, and length of a needle outside the tissue, in m."""


def make_insertion(scenario: FollowingScenario, pushes: list[Push] | None = None) -> Insertion:
    """Return the insertion of a scenario's needle."""
    hand = placed_hand(scenario)
    hand = hand if pushes is None else replace(hand, pushes=pushes)
    return Insertion(hand, np.random.default_rng(draw_seeds(scenario).insertion))


def placed_hand(scenario: FollowingScenario) -> InsertionParameters:
    """Return a scenario's hand with its start, azimuth, entry and initial depth filled in."""
    hand = scenario.hand
    if hand.start is None:
        hand = replace(hand, start=_ready_time(scenario))
    if hand.azimuth_spread_deg > 0:
        rng = np.random.default_rng([draw_seeds(scenario).insertion, 1])
        azimuth_deg = hand.azimuth_deg + hand.azimuth_spread_deg * float(rng.uniform(-1, 1))
        hand = replace(hand, azimuth_deg=azimuth_deg, azimuth_spread_deg=0.0)
    if hand.entry is not None:
        return hand
    surface = load_tissue(scenario.phantom).surface
    direction = hand.direction
    aim, depth = hand.aim, hand.initial_depth
    if aim is None:
        aim = _default_aim(scenario.station.probe, direction, surface)
    try:
        entry = surface.entry(aim, direction)
    except ValueError as error:
        raise ValueError(f"hand.{error}") from error
    if hand.aim is None and depth is None:
        depth = max(float(np.linalg.norm(entry - aim)) - _APPROACH, 0.0)
    return replace(hand, entry=entry.tolist(), aim=None, initial_depth=depth)


def _ready_time(scenario: FollowingScenario) -> float:
    """Return the time in s at which the probe has landed and two sweeps show resting tissue."""
    descent = scenario.station.probe.height / scenario.controller.force.approach_speed
    return descent + _SETTLING + 3 / scenario.imaging.volume_rate


def _default_aim(
    probe: ProbePlacement, direction: NDArray[np.float64], surface: BodySurface
) -> list[float]:
    """Return a point in T below the probe, moved back until the needle enters beside the probe."""
    top = surface.height(probe.x, probe.y)
    heading = np.array([direction[0], direction[1], 0.0])
    level = float(np.linalg.norm(heading))
    fall = -float(direction[2])
    moved = 0.0
    if fall > 1e-6 and level > 1e-6:
        moved = max(_ASIDE - _AIM_DEPTH * level / fall, 0.0)
        heading = heading / level
    aim = np.array([probe.x, probe.y, top - _AIM_DEPTH]) - moved * heading
    return [float(each) for each in aim]


def check_entry(scenario: FollowingScenario, surface: BodySurface) -> None:
    """Check that the needle enters the phantom."""
    hand = scenario.hand
    entries = {"hand.entry": placed_hand(scenario).entry}
    for number, push in enumerate(hand.pushes):
        entries[f"hand.pushes.{number}.entry"] = push.entry
    signs = np.array(np.meshgrid(*3 * [[-1.0, 1.0]])).reshape(3, -1).T
    width, length, height = surface.size
    for name, entry in entries.items():
        if entry is None:
            continue
        require(
            bool(surface.contains(entry + signs * hand.entry_spread).all()),
            name,
            entry,
            "in the phantom or on its surface, entry_spread included: "
            f"a {surface.shape}, |x| up to {width / 2:g}, |y| up to {length / 2:g}, "
            f"z from {-height:g} to 0 m",
        )


def check_beside_probe(
    scenario: FollowingScenario, insertion: Insertion, surface: BodySurface
) -> None:
    """Check that the needle outside the phantom passes beside the probe where it has landed."""
    station = scenario.station
    X_TP = station.X_WT.InvertAndCompose(station.probe_pose(height=-_INDENTATION, surface=surface))
    outside = insertion.entry - np.outer(np.arange(0.0, _SHAFT, 1e-3), insertion.direction)
    points = X_TP.inverse().multiply(outside.T).T
    gap = distance_to_probe(load_probe_body(scenario.probe), points)
    radius = OUTER_DIAMETER[scenario.hand.gauge] / 2
    if gap < radius:
        raise ValueError(
            f"hand: the needle would pass through the probe, by {1e3 * (radius - gap):.1f} mm, "
            f"on its way to its entry {np.round(insertion.entry, 4).tolist()}; move station.probe "
            "or hand.aim aside, or lower hand.dip_deg"
        )


def check_followed(scenario: FollowingScenario, insertion: Insertion, surface: BodySurface) -> None:
    """Check that the arm can follow the needle to its deepest point."""
    deepest = max(np.linspace(0, scenario.duration, 200), key=insertion.depth)
    needle = insertion.needle(deepest)
    if not needle:
        return
    station, direction = scenario.station, needle.curve.direction
    start = station.probe.yaw_deg
    # The needle's axis has no sense, so the probe turns to it the shorter way.
    turn = (np.rad2deg(np.arctan2(direction[1], direction[0])) - start + 90) % 180 - 90
    x, y, _ = needle.tip
    pose = station.probe_pose(x=x, y=y, yaw_deg=start + turn, height=0.0, surface=surface)
    if not check_reach(station, [pose], scenario.probe, surface)[0]:
        raise ValueError(
            f"hand: the arm cannot follow the needle to its deepest point, x {x:.3f}, y {y:.3f} m "
            f"on the phantom, with the probe turned to {start + turn:.0f} deg"
        )
