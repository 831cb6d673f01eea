"""Rows of the loop, from logs of runs that never happened."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_logs import build_insertion_log

from sonoservo.diagrams.papers.zhao2012.speed_report import CLOSED_LOOP, NO_VELOCIMETER, loop_rows
from sonoservo.diagrams.studies import Case, Outcome
from sonoservo.diagrams.studies.following.analysis import AS_PUBLISHED, describe_run, load_case
from sonoservo.systems.evaluation import summarize
from sonoservo.systems.files.writing import to_plain
from sonoservo.systems.ultrasound import load_transducer, sweep_geometry

SPEED = "speed in the loop, all"
PUSHES = "hand.pushes=[{duration: 2, speed: 0.005}, {duration: 8, speed: 0.005}]"


@pytest.fixture(scope="module")
def rows():
    """Ours is 0.2 mm/s too fast, the published method 2 mm/s too slow, the baseline right."""
    log = build_insertion_log()
    log = replace(log, visible_length=log.inserted_length)
    k = (log.needle_tip - log.needle_entry)[-1]
    k = k / np.linalg.norm(k)
    outcomes = []
    errors = {"": 0.2e-3, AS_PUBLISHED: -2e-3, NO_VELOCIMETER: 0.0}
    for experiment in (CLOSED_LOOP, SPEED):
        for ending, error in errors.items():
            velocity = np.tile((5e-3 + error) * k, (len(log.volume_time), 1))
            made = replace(log, volume_estimate_velocity=velocity)
            for seed in range(6):
                settings = {
                    "scenario": "chatelain2013_fig5",
                    "changes": ["hand.start=2", PUSHES, "duration=20"],
                }
                case = Case(experiment + ending, seed, settings)
                scenario = load_case(case)
                geometry = sweep_geometry(load_transducer(scenario.probe), scenario.imaging)
                result = {"summary": summarize(made), **describe_run(made, scenario, geometry)}
                outcomes.append(Outcome(case, to_plain(result)))
    return {(row.experiment, row.quantity): row for row in loop_rows(outcomes)}


def test_speeds_are_judged_by_true_speed_and_method(rows):
    when = "at 5 mm/s, while tracked, from 1 s after a change on"
    bias = rows[SPEED, f"speed along the needle, bias {when}"]
    assert bias.true == pytest.approx(0.2, abs=1e-6)
    assert bias.low == pytest.approx(0.2, abs=1e-6)
    assert bias.published_true == pytest.approx(-2.0, abs=1e-6)
    assert rows[SPEED, f"speed along the needle, RMSE {when}"].published_true == pytest.approx(2.0)
    baseline = rows[
        SPEED, f"speed along the needle, bias {when}, the same filter without velocimeter"
    ]
    assert baseline.true == pytest.approx(0.0, abs=1e-6)
    assert baseline.published_true is None
    size = rows[SPEED, f"speed along the needle, size of the bias {when}"]
    assert (size.target, size.verdict) == (0.5, "yes")
    missing = rows[SPEED, "volumes not tracked at 5 mm/s, from 1 s after a change on"]
    assert missing.true == missing.published_true == 0


def test_the_loop_has_rows_of_both_methods(rows):
    rest = rows[CLOSED_LOOP, "at rest, all runs, median |X|"]
    assert None not in (rest.true, rest.estimated, rest.published_true, rest.published_estimated)
    assert rest.paper is None
    lost = rows[CLOSED_LOOP, "times lost, all runs"]
    assert lost.true == lost.published_true == 0
