"""The closed loop against what the paper reports, with the truth as judge."""

import numpy as np
import pytest

from sonoservo.diagrams import load_scenario, run
from sonoservo.systems.typed_yaml import ConfigurationError


def assert_finds_and_follows(summary, x_mm):
    """Chatelain 2013, section IV-C: what it reports as estimated must hold in truth."""
    assert summary["detection"]["volume"] is not None
    assert summary["detection"]["visible_mm"] < 15
    assert summary["detection"]["false_starts"] == 0
    tracking = summary["tracking"]
    assert tracking["tracked"] > 0.9 * tracking["volumes"]
    assert tracking["axis_error_deg"]["median"] < 1
    at_rest = summary["servo"]["at_rest"]
    assert at_rest["seconds"] > 3
    assert at_rest["x_mm"] <= x_mm
    assert at_rest["z_mm"] <= 0.23
    assert at_rest["theta_deg"] <= 0.97
    force = summary["force"]
    assert abs(force["mean_n"] - 2.0) <= 0.1
    assert force["rms_error_n"] <= 0.1
    assert force["max_n"] < 3.0


def test_finds_the_needle_turns_and_follows():
    # At rest the needle's own speckle, which then never changes, puts the tip off by 0.6 mm (one
    # deviation over seeds): in one run by up to three of them.
    assert_finds_and_follows(run(load_scenario("chatelain2013_fig5", seed=0)).summary, x_mm=1.8)


@pytest.mark.slow
def test_over_seeds_the_tip_is_centred_as_well_as_the_paper_reports():
    summaries = [run(load_scenario("chatelain2013_fig5", seed=seed)).summary for seed in range(5)]
    for summary in summaries:
        assert_finds_and_follows(summary, x_mm=1.8)
    assert np.mean([each["servo"]["at_rest"]["x_mm"] for each in summaries]) <= 1.10


def test_the_same_seed_gives_the_same_summary():
    scenario = load_scenario(
        "chatelain2013_fig5",
        seed=3,
        changes=["duration=8", "hand.start=2", "hand.pushes.0.speed=0.016"],
    )
    first, second = (run(scenario).summary for _ in range(2))
    for name in ("wall_s", "real_time_factor", "compute_ms"):
        assert first.pop(name) != second.pop(name)
    assert first == second
    other = run(load_scenario("chatelain2013_fig5", seed=4, changes=["duration=8"])).summary
    assert other["force"] != first["force"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["hand.entry=[-0.12, 0.6, -0.04]"], "hand.entry: .* in the phantom or on its surface"),
        (["station.phantom_position=[0.78, 0, 0.2]"], "hand: the arm cannot follow"),
        (["station.phantom_position=[1.2, 0, 0.2]"], "cannot reach the probe pose"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_moves(changes, message):
    changes = ["hand.pushes.0.speed=0.02", *changes]
    with pytest.raises(ConfigurationError, match=message):
        run(load_scenario("chatelain2013_fig5", changes=changes))
