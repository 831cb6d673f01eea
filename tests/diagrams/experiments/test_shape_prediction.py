import numpy as np
import pytest

from sonoservo.diagrams import estimate_shape, load_scenario, make_experiment, run
from sonoservo.diagrams.experiments.shape_prediction_scenario import ESTIMATORS
from sonoservo.diagrams.shape_predictor import predict_from_slices
from sonoservo.systems.evaluation.shape.shape_metrics import cross_section_errors, prediction
from sonoservo.systems.signals import NeedleShape

SHORT = ["depth=0.04", "rotations=[0.025]", "observe_until=0.025", "step=1e-3"]


@pytest.fixture(scope="module")
def experiment():
    experiment = make_experiment(load_scenario("carriere2016_d60", changes=SHORT, seed=103))
    experiment.run()
    return experiment


def test_the_needle_is_followed_and_its_shape_predicted(experiment):
    log = experiment.log()
    errors = cross_section_errors(log)
    assert np.isfinite(errors).sum() >= 37
    assert np.nanmedian(errors) < 0.2e-3
    figures = prediction(log, experiment.shape)
    assert figures["observed_mm"] == pytest.approx(25.0)
    # 15 mm beyond what was seen, and beyond the rotation.
    assert figures["tip_error_true_mm"] < 0.6
    assert figures["tip_std_mm"] < 0.6


@pytest.mark.parametrize("roll", [0, 90, 180, 270])
def test_the_shaft_is_seen_behind_the_bevel_wherever_that_faces(roll):
    few = ["depth=0.006", "rotations=[]", "observe_until=0.004"]
    turned = [f"hand.bend_roll_deg={roll}", "hand.bend_roll_spread_deg=0"]
    experiment = make_experiment(load_scenario("carriere2016_d60", changes=few + turned, seed=120))
    experiment.run()
    errors = cross_section_errors(experiment.log())
    assert np.isfinite(errors[:-1]).all()
    assert np.nanmax(errors) < 0.5e-3


def test_uncertainty_shrinks_with_every_part_of_the_needle_that_is_seen(experiment):
    log = experiment.log()
    std = np.sqrt(np.linalg.eigvalsh(log.tip_covariance[5:])[:, -1])
    assert std[20] < 0.25 * std[0]
    # Nothing beyond the last slice that may be used changes the prediction.
    assert np.ptp(log.tip[26:], axis=0).max() == 0


def test_slices_that_were_lost_are_missing_and_the_others_keep_their_depth():
    changes = ["depth=0.03", "observe_until=0.02"]
    whole, some = (
        run(load_scenario("carriere2016_patient", changes=changes + more, seed=104)).log
        for more in ([], ["scanner.connection.lost_sweeps=0.4"])
    )
    kept = np.isin(whole.depth, some.depth)
    assert 0 < len(some.depth) == kept.sum() < len(whole.depth)
    np.testing.assert_array_equal(some.true, whole.true[kept])


@pytest.mark.parametrize("name", ESTIMATORS)
def test_every_estimator_takes_the_same_cross_sections(experiment, name):
    shapes = estimate_shape(experiment.make_estimator(name), experiment.cross_sections)
    assert isinstance(shapes[-1], NeedleShape)
    assert np.isfinite(shapes[-1].predict([0.04])[0]).all()


def test_a_needle_that_leaves_the_image_is_said_to_be_lost_and_the_tip_uncertain():
    changes = [
        "imaging.sector=0.1",
        "hand.entry=[-0.045, 0.002, -0.03]",
        "hand.entry_spread=[0, 0, 0]",
    ]
    changes += ["hand.bend_angle_spread_deg=8", "hand.bend_radius=0.35"]
    changes += ["hand.bend_radius_spread=0.05"]
    lost = []
    for seed in range(100, 105):
        scenario = load_scenario("carriere2016_patient", changes=changes, seed=seed)
        result = run(scenario)
        found = np.isfinite(result.log.correlation)
        if not found[-1]:
            lost.append(seed)
            assert result.log.reason[-1]
        if isinstance(result.results["shape"], NeedleShape):
            mean, covariance = result.results["shape"].predict([scenario.depth])
            error = mean[0] - result.log.true[-1, :2]
            assert error @ np.linalg.solve(covariance[0], error) < 30
    assert len(lost) >= 1


def test_recorded_slices_give_what_the_live_run_gave():
    experiment = make_experiment(load_scenario("carriere2016_patient", seed=105))
    slices = []
    experiment.run(lambda each: slices.append(each.evaluate(each.slice_converter, "slice")))
    scenario = experiment.scenario
    found, shapes = predict_from_slices(experiment.make_predictor(scenario), slices)
    live = [each.position for each in experiment.cross_sections]
    np.testing.assert_array_equal([each.position for each in found if each], live)
    np.testing.assert_array_equal(shapes[-1].tip, experiment.shape.tip)
    published = load_scenario("carriere2016_patient", seed=105, as_published=True)
    found, shapes = predict_from_slices(experiment.make_predictor(published), slices)
    # The click is the same, and the printed tracker takes it as it is.
    click = experiment.X_WP.inverse().multiply(found[0].position)[:2]
    truth = experiment.true_path(np.zeros(1))[0, :2]
    assert 0 < np.linalg.norm(click - truth) < 2e-3
    assert all(found)
    assert isinstance(shapes[-1], NeedleShape)
