import json
from dataclasses import replace

import numpy as np
import pytest

from sonoservo.diagrams.experiments.shape_prediction_scenario import ESTIMATORS
from sonoservo.diagrams.papers.carriere2016 import reproduction as carriere2016
from sonoservo.diagrams.papers.carriere2016.report import set_rows
from sonoservo.diagrams.papers.carriere2016.reproduction import reproduce
from sonoservo.diagrams.papers.carriere2016.runs import SETS, UNEVEN, run_needle
from sonoservo.diagrams.studies.study import Case, StudyOptions
from sonoservo.diagrams.studies.study_report import write_study

SHORT = ["depth=0.03", "rotations=[0.02]", "observe_until=0.02", "step=1e-3"]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Two needles of each set, the beef's short, through the code of the full study."""
    folder = tmp_path_factory.mktemp("study")
    settings = carriere2016._settings

    def short(name, first):
        whole = settings(name, first)
        return whole if name == "patient" else {**whole, "changes": whole["changes"] + SHORT}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(carriere2016, "_settings", short)
        options = StudyOptions(folder=folder, seeds=2, first_seed=100, jobs=1)
        return folder, reproduce(options)


def test_all_needles_run_with_all_estimators(study):
    _, result = study
    assert len(result.outcomes) == 8
    for outcome in result.outcomes:
        assert outcome.error == ""
        assert set(outcome.result["estimators"]) == set(ESTIMATORS)


def test_rows_name_the_paper_the_targets_and_the_truth(study):
    _, result = study
    rows = {(row.experiment, row.quantity): row for row in result.rows}
    assert {row.experiment for row in result.rows} == {*SETS, UNEVEN}
    tip = rows["d60", "tip error, particle filter, measured path"]
    assert (tip.paper, tip.target) == (0.497, 0.497)
    assert tip.estimated is not None
    assert rows["d60", "tip error, particle filter, true path"].true < 1.0
    assert rows["d60", "tip error, filter as printed, measured path"].target is None
    assert rows["patient", "cross-section's error, median over needles"].met
    assert all(row.target is None for row in result.rows if row.experiment == UNEVEN)


def test_the_report_stands_by_itself(study, tmp_path):
    _, result = study
    write_study(tmp_path, result, "sonoservo reproduce carriere2016 --quick")
    data = json.loads((tmp_path / "study.json").read_text())
    assert len(data["rows"]) == len(result.rows)
    names = {path.name for path in tmp_path.glob("*.png")}
    assert names == {
        "paths.png", "error_against_depth.png", "errors.png", "particles.png"
    }  # fmt: skip
    assert "http" not in (tmp_path / "report.html").read_text().replace("http-equiv", "")


def test_a_run_that_failed_counts_as_a_needle_that_was_not_followed(study):
    _, result = study
    good = [each for each in result.outcomes if each.case.experiment == "patient"]
    failed = replace(good[0], error="ValueError: no needle", result={})
    followed = {row.quantity: row for row in set_rows("patient", [good[1], failed])}
    assert followed["needles followed to the end"].true == 50.0


def test_a_needle_is_repeatable_and_its_bound_is_that_of_a_normal_distribution():
    settings = {"scenario": "carriere2016_patient", "changes": [], "keep_particles": False}
    first, second = (run_needle(Case("patient", 101, settings)) for _ in range(2))
    for name in ESTIMATORS:
        assert np.array_equal(first["paths"][name], second["paths"][name])
    figures = first["estimators"]["least_squares"]
    # The plane of most deflection sees at most the largest deviation.
    most = np.sqrt(2 / np.pi) * figures["tip_std_mm"]
    assert 0.3 * most < figures["expected_tip_true_mm"] <= most
    assert figures["expected_tip_measured_mm"] > figures["expected_tip_true_mm"]


@pytest.mark.slow
def test_study_of_ten_needles_meets_the_papers_errors(tmp_path):
    result = reproduce(StudyOptions(folder=tmp_path, seeds=10, first_seed=100))
    rows = {(row.experiment, row.quantity): row for row in result.rows}
    for name in ("d60", "d80"):
        for quantity in ("tip", "shape"):
            assert rows[name, f"{quantity} error, particle filter, measured path"].met
        assert rows[name, "needles followed to the end"].met
