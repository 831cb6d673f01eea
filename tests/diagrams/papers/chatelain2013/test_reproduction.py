"""The reproduction: what is run, and a short version of all of it."""

import json

import numpy as np
import pytest

from sonoservo.diagrams import load_scenario, make_insertion
from sonoservo.diagrams.papers.chatelain2013 import reproduction as chatelain2013
from sonoservo.diagrams.papers.chatelain2013.reproduction import (
    ABLATIONS,
    PROTOCOLS,
    Protocol,
    bent_insertion,
    study_cases,
)
from sonoservo.diagrams.papers.registry import reproduce
from sonoservo.diagrams.studies import StudyOptions, write_study
from sonoservo.diagrams.studies.following.analysis import AS_PUBLISHED, load_case
from sonoservo.systems.needle import Insertion


@pytest.mark.parametrize("seed", [0, 7, 18])
def test_bent_needles_end_in_the_image_and_come_from_the_phantom(seed):
    hand = load_scenario("chatelain2013_fig5", changes=bent_insertion(seed)).hand
    assert 0.15 <= hand.bend_radius <= 0.4
    assert 0 <= hand.dip_deg <= 40
    needle = Insertion(hand, np.random.default_rng(0)).needle(60.0)
    np.testing.assert_allclose(needle.tip, [-0.023, 0, -0.05], atol=0.5e-3)
    x, y, z = hand.entry
    assert -0.12 <= x < -0.06
    assert abs(y) < 0.08
    assert -0.075 <= z <= 0
    assert bent_insertion(seed) == bent_insertion(seed) != bent_insertion(seed + 1)


BOTH = [name for name, each in PROTOCOLS.items() if each.ours and each.compared]


@pytest.mark.parametrize("name", BOTH[::3])
def test_both_methods_meet_the_same_world(name, tmp_path):
    cases = [
        case
        for case in study_cases(StudyOptions(folder=tmp_path, seeds=1))
        if case.experiment in (name, name + AS_PUBLISHED)
    ]
    ours, published = map(load_case, cases)
    assert published.tracker.kind == "chatelain2013_as_published"
    assert published.tracker.order == ours.tracker.order
    assert not published.controller.visual_servo.feed_forward
    for field in ("duration", "station", "hand", "imaging", "phantom_motion", "seed"):
        assert getattr(ours, field) == getattr(published, field)
    if name == "directions":
        make_insertion(published)  # which enters the phantom beside the probe


TIP = "tip error, from 20 mm in view on, median"
FALSE = "false starts, more than 10 mm off or without a needle, all runs"


CHEAP = [
    "station.plant.contact_model=point",
    "scan_conversion.spacing=[1e-3, 1e-3, 1e-3]",
    "imaging.sector=0.55",
]


def test_the_whole_study_in_short(tmp_path, monkeypatch):
    """One quick insertion an experiment, through the same code."""
    quick = ["hand.start=1", "hand.pushes=[{duration: 5.5, speed: 0.014}]", *CHEAP]
    moved = 'phantom_motion.moves=[{"start": 2.2, "duration": 0.3, "translation": [0.005, 0, 0]}]'

    def protocol(scenario, duration, *changes, compared=False):
        return Protocol(scenario, 1, (1, duration), [*quick, *changes], compared=compared)

    five, still = "chatelain2013_fig5", "no needle, probe still"
    monkeypatch.setattr(
        chatelain2013,
        "PROTOCOLS",
        {
            "fig4": protocol("chatelain2013_fig4", 1.5),
            "fig5": protocol(five, 5.8, compared=True),
            "fig6": protocol("chatelain2013_fig6", 3.2, moved),
            "settings, fast": protocol("chatelain2013_fig4", 1.5, "imaging.frames=5"),
            still: protocol("chatelain2013_fig4", 1.5, *PROTOCOLS[still].changes),
            "fig5, no refits": protocol(five, 1.5, *ABLATIONS["no refits"]),
            "fig5, no filter": protocol(five, 1.5, "no.such.field=1"),
        },
    )
    options = StudyOptions(folder=tmp_path, quick=True, jobs=1, first_seed=100)
    study = reproduce("chatelain2013", options)
    write_study(tmp_path, study, "sonoservo reproduce chatelain2013")
    data = json.loads((tmp_path / "study.json").read_text())
    rows = {(row["experiment"], row["quantity"]): row for row in data["rows"]}
    assert rows["fig4", FALSE]["verdict"] == "yes"
    assert rows["fig5", TIP]["true"] < 2
    assert rows["fig5", "contact force, mean"]["true"] == pytest.approx(2, abs=0.1)
    assert rows["fig6", "runs back after every move"]["target"] is None  # of so few runs
    assert rows["fig6", "back after a move, all moves of all runs"]["true"] is not None
    assert rows["fig6", "runs back after every move"]["high"] > 75  # one run tells little
    assert rows["fig6", "force, largest"]["true"] > 2
    assert rows["no needle, probe still", FALSE]["true"] == 0
    assert rows["no needle, probe still", "volumes"]["true"] >= 5
    assert ("fig5, no refits", "axis error, from 20 mm in view on, 95 %") in rows
    for row in data["rows"]:
        # A published figure that was estimated never stands beside our true one alone.
        if row["paper"] is not None and row["unit"] in ("mm", "deg"):
            assert (row["estimated"] is None) == (row["true"] is None)
        if row["published_estimated"] is not None:
            assert row["published_true"] is not None
    (failure,) = data["failures"]
    assert failure["experiment"] == "fig5, no filter"
    assert "no: unknown field" in failure["error"]
    names = {"fig4", "fig5", "fig5_spread", "fig6", "fig6_spread", "errors", "fig5_ablations"}
    assert {path.stem for path in tmp_path.glob("*.png")} == names
    assert (tmp_path / "report.html").read_text().count("data:image/png;base64,") == len(names)
