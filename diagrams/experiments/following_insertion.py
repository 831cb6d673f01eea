"""Insertion of a scenario of following, and checks of it against phantom, probe and arm."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.assembly import load_probe_body
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.scenario import draw_seeds
from sonoservo.diagrams.station import ProbePlacement, check_reach
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.needle.insertion_parameters import (
    OUTER_DIAMETER,
    InsertionParameters,
    Push,
)
from sonoservo.systems.robot.probe_body import distance_to_probe
from sonoservo.systems.signals.body_surface import BodySurface
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.ultrasound.simulation.tissue import load_tissue

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
