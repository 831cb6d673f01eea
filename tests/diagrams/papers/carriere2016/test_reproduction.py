import json
from dataclasses import replace

import numpy as np
import pytest

from sonoservo.diagrams.papers.carriere2016 import reproduction, runs
from sonoservo.diagrams.papers.carriere2016.protocols import PROTOCOLS, Protocol
from sonoservo.diagrams.papers.carriere2016.report import PAPER, set_rows, sweep_rows
from sonoservo.diagrams.papers.carriere2016.runs import AS_PUBLISHED, TAUGHT, run_needle
from sonoservo.diagrams.papers.registry import reproduce
from sonoservo.diagrams.studies import Case, Outcome, StudyOptions, write_study

SHORT = ["depth=0.03", "rotations=[0.02]", "observe_until=0.02", "step=1.5e-3"]
SHORT += ["imaging.sector=0.4", "particle_filter.particles=150", "published.particles=150"]
FEW = {
    "gamma": {"0.1": ["published.gain=0.1"]},
    "template": {"4 mm": ["tracker.template=[4e-3, 4e-3]"]},
}


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Two needles of each set and of one departure, the beef's short, as in the full study."""
    folder = tmp_path_factory.mktemp("study")
    protocols = {
        "d60": Protocol("carriere2016_d60", 2, 2, SHORT, whole=True, learnt="even"),
        "patient": PROTOCOLS["patient"],
        "curvature wanders by 10 %": Protocol(
            "carriere2016_d60", 2, 2, [*SHORT, "hand.curvature_wander=0.1"], learnt="even"
        ),
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reproduction, "PROTOCOLS", protocols)
        patch.setattr(reproduction, "LESSONS", {"even": SHORT})
        patch.setattr(reproduction, "QUICK_LESSON_SEEDS", range(900, 901))
        patch.setattr(runs, "SWEEPS", FEW)
        options = StudyOptions(folder=folder, quick=True, seeds=2, first_seed=100, jobs=1)
        return reproduce("carriere2016", options)


@pytest.fixture(scope="module")
def rows(study):
    return {(row.experiment, row.quantity): row for row in study.rows}


def test_all_needles_run_with_all_methods(study):
    assert len(study.outcomes) == 6
    for outcome in study.outcomes:
        assert outcome.error == ""
        methods = set(outcome.result["methods"])
        assert {"particle_filter", "least_squares", AS_PUBLISHED} <= methods
        assert (TAUGHT in methods) == (outcome.case.experiment != "patient")


def test_each_row_has_both_methods_the_paper_s_figure_and_an_interval(rows):
    tip = rows["d60", "tip error, mean"]
    assert (tip.paper, tip.target) == (0.497, 0.497)
    values = (tip.estimated, tip.true, tip.published_estimated, tip.published_true)
    assert all(value is not None for value in values)
    # Two needles do not tell a mean's interval.
    assert (tip.low, tip.high) == (-np.inf, np.inf)
    assert (tip.published_low, tip.published_high) == (-np.inf, np.inf)
    assert rows["d60", "tip error, standard deviation"].paper == 0.38
    assert rows["patient", "shape error, mean"].paper == PAPER["patient"]["shape"]
    # Without the error of the search for cross-sections, what is left is the filter's own.
    exact = rows["d60", "tip error, filter as printed, exact cross-sections, mean"]
    assert exact.published_true > 0
    assert exact.true is None
    share = rows["patient", "needles followed to the end"]
    # Wilson's interval of two of two.
    assert (share.true, share.low) == (100.0, pytest.approx(34.24, abs=0.01))


def test_a_departure_has_no_measured_tip_and_no_figure_of_the_paper(rows):
    name = "curvature wanders by 10 %"
    tip = rows[name, "tip error, mean"]
    assert tip.paper is None
    assert tip.estimated is None
    assert tip.true > 0
    assert (name, "needles followed to the end") not in rows
    assert rows[name, "tip error, bound of the root mean square"].true > 0
    stated = rows[name, "tip within its 95 %, wander learnt from earlier needles"]
    assert stated.target is None  # so few needles cannot meet it


def test_a_needle_without_prediction_counts_with_the_worst_error(study):
    good = [each for each in study.outcomes if each.case.experiment == "patient"]
    failed = replace(good[0], error="ValueError: no needle", result={})
    by_name = {row.quantity: row for row in set_rows("patient", [good[1], failed])}
    alone = {row.quantity: row for row in set_rows("patient", [good[1]])}
    assert by_name["tip error, mean"].true == alone["tip error, mean"].true
    assert by_name["needles followed to the end"].true == 50.0
    assert by_name["measured tips that are missing"].true == 50.0
    # Coverage is known of one needle only.
    assert by_name["tip within its 95 %, default wander"].low < 25
    unknown = replace(good[1], result={**good[1].result, "bound": {"tip_mm": None}})
    by_name = {row.quantity: row for row in set_rows("patient", [unknown])}
    assert by_name["tip error, bound of the root mean square"].true is None


def test_parameters_of_the_published_method_are_swept(study):
    mine = [each for each in study.outcomes if each.case.experiment == "d60"]
    rows = {row.quantity: row for row in sweep_rows(mine)}
    assert set(rows) == {
        f"{each} error, {value}, mean"
        for each in ("tip", "shape")
        for value in ("gamma = 0.1", "template = 4 mm")
    }
    assert all(row.published_true > 0 and row.true is None for row in rows.values())
    assert sweep_rows([]) == []


def test_the_report_stands_by_itself(study, tmp_path):
    write_study(tmp_path, study, "sonoservo reproduce carriere2016 --quick")
    data = json.loads((tmp_path / "study.json").read_text())
    assert len(data["rows"]) == len(study.rows)
    names = {path.stem for path in tmp_path.glob("*.png")}
    assert names == {
        "paths", "error_against_depth", "errors", "departures", "particles",
        "slice_d60", "slice_patient", "sweeps_d60", "sweeps_patient",
    }  # fmt: skip
    assert "http" not in (tmp_path / "report.html").read_text().replace("http-equiv", "")


def test_a_needle_is_repeatable_and_no_estimate_beats_its_bound_by_much():
    settings = {
        "scenario": "carriere2016_patient", "changes": [], "whole": True, "wander": None,
        "sweeps": False, "keep": False,
    }  # fmt: skip
    case = Case("patient", 101, settings)
    first, second = (run_needle(case) for _ in range(2))
    for name in first["methods"]:
        assert np.array_equal(first["paths"][name], second["paths"][name])
    # What the estimate states cannot be much less than what is possible.
    stated = first["methods"]["particle_filter"]["tip_std_mm"]
    assert stated > 0.7 * first["bound"]["tip_mm"]
    assert Outcome(case, first).result["bound"]["noise_mm"] < 0.3
