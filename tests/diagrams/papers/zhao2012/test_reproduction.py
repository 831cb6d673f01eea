"""The reproduction: the phantom, a short version of every run, and the rows it makes of results."""

import json
from dataclasses import replace

import numpy as np
import pytest

from sonoservo.diagrams.papers.registry import reproduce
from sonoservo.diagrams.papers.zhao2012 import reproduction as zhao2012
from sonoservo.diagrams.papers.zhao2012.phantom import DIRECTION, Phantom, StraightNeedle
from sonoservo.diagrams.papers.zhao2012.published_tracking import with_input
from sonoservo.diagrams.papers.zhao2012.report import report
from sonoservo.diagrams.papers.zhao2012.runs import ESTIMATORS, QUANTITIES, SPEEDOMETERS, run_case
from sonoservo.diagrams.studies import Case, Outcome, Study, StudyOptions, write_study
from sonoservo.systems.signals import NeedleCurve, NeedleMeasurement
from sonoservo.systems.tracking.axis_tip_filter import AxisTipFilter


@pytest.fixture(scope="module")
def phantom():
    return Phantom(StraightNeedle(np.array([-6e-3, 0, -13e-3]), DIRECTION), seed=100)


def test_needle_moves_as_it_is_pushed_and_is_as_bright_as_its_scatterers(phantom):
    """125/mm^3 of amplitude 7.5 in 10/mm^3 of power 4: 22 dB where the beam lies in the needle."""
    short, long = (phantom.sweep(length, 0.0) for length in (6e-3, 9e-3))
    tissue = phantom.renderer.on_carrier(phantom._tissue)

    def power(sweep, behind_tip, length):
        p_W = phantom.needle.tip(length) - behind_tip * DIRECTION
        k, j, i = np.round(sweep.index(sweep.to_probe(p_W[np.newaxis])[0])).astype(int)
        near = np.s_[k, j - 1 : j + 2, i - 8 : i + 9]
        return np.mean((sweep.lines - tissue)[near] ** 2), np.mean(tissue[near] ** 2)

    # Nothing beyond the short needle's tip, where the long one is.
    assert power(short, -2e-3, 6e-3)[0] < 1e-3 * power(long, 1e-3, 9e-3)[0]
    stretch = np.arange(1e-3, 5e-3, 0.25e-3)
    levels = np.mean([power(long, behind, 9e-3) for behind in stretch], axis=0)
    # The beam, 0.95 mm wide in elevation, spends a part of itself beside the needle.
    assert 18 < 10 * np.log10(levels[0] / levels[1]) < 24


def test_the_published_density_leaves_the_speckle_undeveloped(phantom):
    near = np.s_[8:45, 10:61, round(0.045 / 2.8519e-5) : round(0.055 / 2.8519e-5)]
    intensity = np.abs(phantom._tissue[near]).astype(float) ** 2
    assert (intensity**2).mean() / intensity.mean() ** 2 == pytest.approx(2 + 1 / 1.75, abs=0.1)


def test_the_tracker_follows_a_needle_in_the_dynamic_run():
    settings = {"phantom": 100, "speeds_mm_s": 6 * [1.0], "interval_s": 0.3}
    result = run_case(Case("dynamic, fresh speckle", 100, settings))
    errors = np.array(result["errors"], dtype=float)
    assert errors.shape == (7, len(ESTIMATORS), len(QUANTITIES))
    np.testing.assert_allclose(
        errors[..., 5], np.linalg.norm(errors[..., 2:5], axis=-1), atol=1e-12
    )
    rmse = np.sqrt(np.mean(errors[2:] ** 2, axis=0))
    final = rmse[ESTIMATORS.index("kalman_velocity")]
    assert final[5] < 0.3
    assert final[5] < rmse[0, 5]
    assert (final[:2] < 2).all()
    published = rmse[ESTIMATORS.index("published")]
    assert published[5] < 1.5
    speeds = np.array(result["speeds_mm_s"], dtype=float)[2:]
    velocimeter = speeds[:, SPEEDOMETERS.index("velocimeter")]
    assert np.isfinite(velocimeter).sum() >= 3
    assert np.nanmax(np.abs(velocimeter - 1)) < 0.3
    assert np.isfinite(speeds[:, SPEEDOMETERS.index("with")]).all()
    json.dumps({**result, "errors": None})


def test_a_resting_needle_is_tracked_too():
    settings = {"phantom": 100, "volumes": 4, "lengths_mm": [20]}
    errors = np.array(run_case(Case("static, x", 101, settings))["errors"], dtype=float)
    assert errors.shape == (1, 4, len(ESTIMATORS), len(QUANTITIES))
    assert np.abs(errors[0, 2:, 2:, 5]).max() < 0.5
    assert np.abs(errors[0, 2:, 2:, :2]).max() < 1.0
    # The same volume, other draws: they differ by the published RANSAC's randomness.
    assert np.std(errors[0, :, 0, 1]) > 0.1


def test_kept_voxels_decide_what_ransac_finds():
    settings = {"phantom": 102, "length_mm": 20, "kept_mm3": [60, 100]}
    tips = run_case(Case("kept voxels, 20 mm", 102, settings))["tip_mm"]
    assert len(tips) == 2
    assert all(tip is None or tip < 30 for tip in tips)
    assert any(tip is not None and tip < 2 for tip in tips)


def test_noise_that_the_paper_leaves_open_is_swept():
    push = {"phantom": 100, "speed_mm_s": 1.0, "interval_s": 0.3, "volumes": 4}
    noises = {name: zhao2012.NOISES[name] for name in list(zhao2012.NOISES)[::4]}
    case = Case("open values", 100, {**push, "noises": noises})
    made = Outcome(case, run_case(case))
    assert {len(each) for each in made.result["tip_mm"].values()} == {4}
    rows = report([made]).rows
    assert len(rows) == len({row.published_true for row in rows}) == len(noises)


def test_a_commanded_change_of_speed_moves_the_prediction():
    curve = NeedleCurve([[0, 0, 0], [0.01, 0, 0]])
    needle_filter = AxisTipFilter()
    state = needle_filter.start(NeedleMeasurement(curve, 1e-6 * np.eye(6), 0.0, 0, 0.0))
    without = needle_filter.predict(state, 1.0)
    moved = with_input(without, 2e-3, 1.0)
    np.testing.assert_allclose(moved.tip, without.tip + np.array([2e-3, 0, 0]))
    np.testing.assert_allclose(moved.tip_velocity, [2e-3, 0, 0])
    np.testing.assert_allclose(moved.curve.entry, without.curve.entry, atol=1e-12)
    assert moved.length == pytest.approx(without.length + 2e-3)


def outcomes(scales):
    """Runs whose errors have a known size for each estimator: +s and -s, by turns."""
    made = []
    for name in ("dynamic, fresh speckle", "static, fresh speckle"):
        for seed in range(2):
            one = np.multiply.outer(scales, np.ones(6)) * (-1) ** seed
            shape = (16,) if name.startswith("dynamic") else (2, 8)
            errors = np.broadcast_to(one, (*shape, *one.shape)).tolist()
            settings = {"lengths_mm": [5, 20], "phantom": seed}
            speeds = [[None] * 5, *[[1.1] * 5] * 15]
            settings |= {"speeds_mm_s": 15 * [1.0], "interval_s": 1.0}
            result = {"errors": errors, "speeds_mm_s": speeds, "compute_s": [0.02]}
            made.append(Outcome(Case(name, seed, settings), result))
    return made


def row(study, experiment, quantity):
    (found,) = (r for r in study.rows if (r.experiment, r.quantity) == (experiment, quantity))
    return found


def test_rows_are_what_the_errors_say(monkeypatch, tmp_path):
    monkeypatch.setattr(
        zhao2012, "run_study", lambda *_, **__: outcomes([2.0, 1.0, 0.8, 0.5, 0.4, 0.4])
    )
    study = reproduce("zhao2012", StudyOptions(folder=tmp_path))
    for experiment, published in (("static, fresh speckle", 58), ("dynamic, fresh speckle", 37)):
        alpha = row(study, experiment, "alpha: RMSE less than with RANSAC")
        assert (alpha.paper, alpha.true) == (published, pytest.approx(60))
        assert alpha.verdict == "undecided"  # two runs tell nothing
        assert alpha.published_true == pytest.approx(20)
        assert (alpha.low, alpha.high) == (-np.inf, np.inf)
        sample = row(study, experiment, "alpha: RMSE less than with RANSAC, best sample")
        assert sample.true == pytest.approx(80)
        assert row(study, experiment, "x: RMSE less than with our RANSAC").true == pytest.approx(20)
        assert row(study, experiment, "tip: largest RMSE from 15 mm on").true == pytest.approx(0.4)
        assert row(study, experiment, "tip: largest RMSE from 15 mm on").verdict == "yes"
    dynamic, speed = (
        "dynamic, fresh speckle",
        "speed along the needle, {}, velocimeter in our tracker",
    )
    assert row(study, dynamic, "speed found, velocimeter in our tracker").true == 100
    assert row(study, dynamic, speed.format("RMSE")).true == pytest.approx(0.1)
    assert row(study, dynamic, speed.format("bias")).true == pytest.approx(0.1)
    data = write_study(tmp_path, study, "sonoservo reproduce zhao2012")
    assert len(data["rows"]) == len(study.rows)
    assert (tmp_path / "dynamic_fresh_speckle_tip.png").stat().st_size > 10_000


def test_failures_and_missing_errors_count_as_the_worst_of_the_others(monkeypatch, tmp_path):
    made = outcomes([2.0, 1.0, 0.8, 0.5, 0.4, 0.4])
    made[0] = replace(made[0], result={}, error="ValueError: a reason")
    errors = made[1].result["errors"]
    errors[5][0] = [None] * 6
    made[1].result["errors"][6][1] = [3.0] * 6
    monkeypatch.setattr(zhao2012, "run_study", lambda *_, **__: made)
    study = reproduce("zhao2012", StudyOptions(folder=tmp_path))
    assert isinstance(study, Study)
    assert study.experiments["dynamic, fresh speckle"]["failed"] == 1
    alpha = row(study, "static, fresh speckle", "alpha: RMSE less than with RANSAC")
    assert alpha.true == pytest.approx(60)
    missing = row(study, "dynamic, fresh speckle", "nothing found, RANSAC, best sample")
    assert missing.true == pytest.approx(100 / 14)
    one_bad = row(study, "dynamic, fresh speckle", "alpha: RMSE, RANSAC")
    assert one_bad.true == pytest.approx((13 * 1.0 + 3.0) / 14)
    tracker = "nothing found, RANSAC + Kalman + velocity"
    assert row(study, "dynamic, fresh speckle", tracker).verdict == "yes"
