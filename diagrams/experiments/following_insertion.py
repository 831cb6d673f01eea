"""Insertion of a scenario of following, and checks of it against phantom and arm."""

from dataclasses import replace

import numpy as np

from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.seeds import draw_seeds
from sonoservo.diagrams.station import check_reach
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.needle.insertion_parameters import Push
from sonoservo.systems.signals.requirements import require


def make_insertion(scenario: FollowingScenario, pushes: list[Push] | None = None) -> Insertion:
    """Return the insertion of a scenario's needle.

    Parameters
    ----------
    scenario
        Scenario with the needle, the hand and the seed.
    pushes
        Pushes that replace the scenario's.
    """
    hand = scenario.hand if pushes is None else replace(scenario.hand, pushes=pushes)
    return Insertion(hand, np.random.default_rng(draw_seeds(scenario).insertion))


def check_entry(scenario: FollowingScenario, size: list[float]) -> None:
    """Check that the needle enters the phantom.

    Parameters
    ----------
    scenario
        Scenario with the entries of the needle.
    size
        (3,) extents of the phantom, in m.

    Raises
    ------
    ValueError
        If an entry may lie outside the phantom; the message names the field.
    """
    half = np.array(size) / 2
    entries = {"hand.entry": scenario.hand.entry}
    for number, push in enumerate(scenario.hand.pushes):
        if push.entry is not None:
            entries[f"hand.pushes.{number}.entry"] = push.entry
    for name, entry in entries.items():
        reach = np.abs(np.subtract(entry, [0, 0, -half[2]])) + scenario.hand.entry_spread
        require(
            bool((reach <= half + 1e-9).all()),
            name,
            entry,
            "in the phantom or on its surface, entry_spread included: "
            f"|x| up to {half[0]:g}, |y| up to {half[1]:g}, z from {-size[2]:g} to 0 m",
        )


def check_followed(scenario: FollowingScenario, insertion: Insertion) -> None:
    """Check that the arm can follow the needle to its deepest point.

    Parameters
    ----------
    scenario
        Scenario with the station and the duration.
    insertion
        Insertion of the needle.

    Raises
    ------
    ValueError
        If the arm cannot reach that point; the message gives it.
    """
    deepest = max(np.linspace(0, scenario.duration, 200), key=insertion.depth)
    needle = insertion.needle(deepest)
    if not needle:
        return
    station, direction = scenario.station, needle.curve.direction
    start = station.probe.yaw_deg
    # The needle's axis has no sense, so the probe turns to it the shorter way.
    turn = (np.rad2deg(np.arctan2(direction[1], direction[0])) - start + 90) % 180 - 90
    x, y, _ = needle.tip
    pose = station.probe_pose(x=x, y=y, yaw_deg=start + turn, height=0.0)
    if not check_reach(station, [pose], scenario.probe)[0]:
        raise ValueError(
            f"hand: the arm cannot follow the needle to its deepest point, x {x:.3f}, y {y:.3f} m "
            f"on the phantom, with the probe turned to {start + turn:.0f} deg"
        )
