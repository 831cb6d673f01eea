"""Insertions by azimuth, dip and aim: their entries, the probe beside them, and a stranger's."""

import numpy as np
import pytest

from sonoservo.diagrams import (
    FollowingScenario,
    ProbePlacement,
    StationParameters,
    load_scenario,
    make_insertion,
    run,
)
from sonoservo.diagrams.experiments.following_scene import (
    check_beside_probe,
    check_entry,
    placed_hand,
)
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.needle import InsertionParameters, Push
from sonoservo.systems.signals import TrackingMode
from sonoservo.systems.ultrasound.simulation import load_tissue

PUSHES = [Push(duration=8, speed=8e-3)]


def scenario(phantom="agar", x=0.0, **hand):
    station = StationParameters(probe=ProbePlacement(x=x))
    return FollowingScenario(
        station=station, phantom=phantom, hand=InsertionParameters(pushes=PUSHES, **hand)
    )


@pytest.mark.parametrize(
    ("phantom", "azimuth_deg", "dip_deg"),
    [("agar", 0.0, 0.0), ("limb", 225.0, 60.0), ("abdomen", 0.0, 60.0)],
)
def test_a_needle_aimed_at_a_point_passes_it_from_the_surface(phantom, azimuth_deg, dip_deg):
    aim = [0.005, -0.005, -0.045]
    made = scenario(phantom, aim=aim, azimuth_deg=azimuth_deg, dip_deg=dip_deg)
    insertion, surface = make_insertion(made), load_tissue(phantom).surface
    assert not surface.contains(insertion.entry - 1e-5 * insertion.direction)
    assert surface.contains(insertion.entry + 1e-5 * insertion.direction)
    way = np.array(aim) - insertion.entry
    np.testing.assert_allclose(np.cross(way, insertion.direction), 0, atol=1e-12)
    assert not insertion.needle(0.0)
    check_entry(made, surface)


@pytest.mark.parametrize(("azimuth_deg", "dip_deg"), [(0.0, 0.0), (90.0, 45.0), (200.0, 70.0)])
def test_by_default_a_needle_comes_in_beside_the_probe_and_below_it(azimuth_deg, dip_deg):
    made = scenario(azimuth_deg=azimuth_deg, dip_deg=dip_deg, x=0.02)
    surface = load_tissue("agar").surface
    insertion = make_insertion(made)
    check_entry(made, surface)
    check_beside_probe(made, insertion, surface)
    middle = np.array([0.02, 0.0])
    assert np.linalg.norm(insertion.entry[:2] - middle) > 0.0399
    start = insertion.needle(0.0)
    tip = start.tip if start else insertion.entry
    below = tip + np.outer(np.linspace(0, 0.06, 61), insertion.direction)
    nearest = np.linalg.norm(below[:, :2] - middle, axis=1).min()
    assert nearest < 0.025  # in the sector, which reaches 41 mm to either side at this depth
    assert insertion.depth(0.0) == pytest.approx(placed_hand(made).initial_depth)


def test_the_hand_waits_until_the_probe_has_landed():
    """15 mm at 10 mm/s, 2 s to settle, and three sweeps at 3.3 per s."""
    assert placed_hand(scenario()).start == pytest.approx(1.5 + 2.0 + 3 / 3.3)
    assert placed_hand(scenario(start=0.0)).start == 0.0
    assert placed_hand(load_scenario("chatelain2013_fig5")).start == 3.0


def test_a_needle_through_the_probe_is_refused():
    through = scenario(aim=[0.0, 0.0, -0.045], dip_deg=75.0)
    surface = load_tissue("agar").surface
    with pytest.raises(ValueError, match="the needle would pass through the probe, by .* mm"):
        check_beside_probe(through, make_insertion(through), surface)
    aside = scenario(aim=[0.0, 0.0, -0.045], dip_deg=75.0, x=0.03)
    check_beside_probe(aside, make_insertion(aside), surface)
    changes = ["hand.entry=null", "hand.aim=[-0.045, 0, -0.045]", "hand.dip_deg=80"]
    changes.append("hand.entry_spread=[0, 0, 0]")
    with pytest.raises(ConfigurationError, match="pass through the probe"):
        run(load_scenario("chatelain2013_fig5", changes=changes))


@pytest.mark.parametrize(
    ("hand", "message"),
    [
        ({"aim": [0.0, 0.0, 0.1]}, r"hand\.aim: \[0.0, 0.0, 0.1\] .* in the phantom, a box"),
        ({"aim": [0.0, 0.0]}, "aim: .* three coordinates"),
        ({"aim": [0, 0, -0.04], "entry": [-0.1, 0, -0.04]}, "aim: .* entry already places"),
        ({"initial_depth": -0.01}, "initial_depth: -0.01"),
    ],
)
def test_what_places_no_needle_is_refused(hand, message):
    with pytest.raises(ValueError, match=message):
        make_insertion(scenario(**hand))


def write(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    return path


NARROW = "imaging: {sector: 0.55, frames: 11, volume_rate: 4.0, depth: 0.08}\n"
"""Fewer lines than by default, for a quick run."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "hand",
    [
        "azimuth_deg: 200, dip_deg: 60, pushes: [{duration: 8, speed: 0.008}]",
        "dip_deg: 70, pushes: [{duration: 8, speed: 0.008}]",
        "azimuth_deg: 90, dip_deg: 5, pushes: [{duration: 8, speed: 0.008}]",
        "dip_deg: 35, pushes: [{duration: 6, speed: 0.012}]",
        "azimuth_deg: 180, dip_deg: 10, aim: [0, 0, -0.045], initial_depth: 0.085,"
        "pushes: [{duration: 20, speed: 0.001}]",
    ],
    ids=["steep", "steepest", "out of the plane", "of a stranger", "slow"],
)
def test_an_insertion_from_anywhere_is_found(tmp_path, hand):
    duration = 24 if "0.001" in hand else 13
    path = write(tmp_path, f"duration: {duration}\nhand: {{{hand}}}\n")
    summary = run(load_scenario(path, seed=101)).summary
    assert summary["detection"]["volume"] is not None
    assert summary["detection"]["false_starts"] == 0
    assert summary["tracking"]["tracked"] > 0.9 * summary["tracking"]["volumes"]


def test_a_needle_that_is_in_view_from_the_start_is_found_anywhere(tmp_path):
    hand = "hand: {dip_deg: 20, aim: [0, 0, -0.045], initial_depth: 0.13}\n"
    path = write(tmp_path, NARROW + "duration: 4\n" + hand)
    found = run(load_scenario(path, seed=100, changes=["tracker.start=anywhere"]))
    modes = found.log.volume_estimate_mode.tolist()
    first = modes.index(TrackingMode.TRACKING)
    assert set(modes[:first]) == {TrackingMode.SEARCHING}
    assert set(modes[first:]) == {TrackingMode.TRACKING}
    assert len(modes) - first > 4
    assert found.summary["detection"]["false_starts"] == 0
    assert found.summary["tracking"]["tip_error_mm"]["median"] < 2


@pytest.mark.slow
def test_the_probe_stays_on_a_curved_body_and_finds_the_needle(tmp_path):
    """On a limb, 15 mm beside its apex, with the face along the skin."""
    text = """phantom: limb
duration: 9.0
station: {probe: {y: 0.015, height: 0.006}}
hand: {dip_deg: 20, gauge: 17, aim: [0.0, 0.006, -0.045], initial_depth: 0.085, start: 3.2,
       pushes: [{duration: 5.5, speed: 0.01}]}
"""
    imaging = NARROW.replace("frames: 11", "frames: 21")
    result = run(load_scenario(write(tmp_path, imaging + text), seed=100))
    summary, log = result.summary, result.log
    assert summary["force"]["mean_n"] == pytest.approx(2.0, abs=0.1)
    assert summary["force"]["contact_lost_s"] == 0
    assert summary["tracking"]["tracked"] > 0.8 * summary["tracking"]["volumes"] > 4
    face_normal = -log.X_WP[0, :3, 1]
    np.testing.assert_allclose(face_normal, [0, 0.25, np.sqrt(1 - 0.25**2)], atol=1e-3)
