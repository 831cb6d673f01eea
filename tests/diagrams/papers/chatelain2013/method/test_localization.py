import dataclasses

import numpy as np
import pytest
from synthetic_volumes import ENTRY, K, Scene

from sonoservo.diagrams.papers.chatelain2013.method.localization import (
    PublishedLocalizationParameters,
    explain_published_localization,
    optimize_locally,
    principal_axis,
    relative_sagitta,
)
from sonoservo.systems.signals import NeedleCurve, NeedlePrediction, NotFound
from sonoservo.systems.tracking.axis import axis_through

SCENE = Scene(seed=5, spacing=1.0e-3, balls=[([0.01, 0.06, 0.03], 2e-3)])
PARAMETERS = PublishedLocalizationParameters()
BENT = np.array([[0, 0, 0], [0.02, 0.0015, 0.0005], [0.04, 0, 0]])


def volume(length):
    return SCENE.volume(1, lambda time: (ENTRY, ENTRY + length * K))


def expected(length, order=2, aside=1e-3, **changes):
    points = ENTRY + np.outer(np.linspace(0, length, order), K) + [0, aside, 0]
    fields = {"entry": points[0]} | changes
    return NeedlePrediction(
        order, 0.0, NeedleCurve(points), np.zeros((order, 3)), 1e-6 * np.eye(3 * order), **fields
    )


def localize(volume, prediction, **changes):
    parameters = dataclasses.replace(PARAMETERS, **changes)
    return explain_published_localization(
        volume, prediction, parameters, np.random.default_rng(0)
    ).measurement


@pytest.mark.parametrize("order", [2, 3])
def test_axis_and_tip_around_a_prediction(order):
    found = localize(volume(0.03), expected(0.03, order))
    assert np.degrees(np.arccos(found.curve.direction @ K)) < 5  # one refit leaves outliers in
    assert np.linalg.norm(found.curve.tip - ENTRY - 0.03 * K) < 4e-3
    assert found.curve.order == order
    np.testing.assert_allclose(found.covariance, 1e-6 * np.eye(3 * order))


def test_an_entry_alone_gives_no_direction_but_a_length():
    inward = NeedleCurve([ENTRY, ENTRY + np.array([0, 3e-3, 0])])
    entered = dataclasses.replace(expected(0.03), curve=inward, entry=None)
    found = localize(volume(0.02), entered)
    assert found.curve.direction @ K > 0.98  # from the entry on, not towards it
    assert "of the needle are visible" in localize(volume(0.02), entered, min_length=0.05).reason


def test_the_angle_discards_models():
    across = NeedleCurve([ENTRY + 0.01 * K, ENTRY + 0.01 * K + [0, 0.01, 0]])
    turned = dataclasses.replace(expected(0.03), curve=across)
    found = localize(volume(0.03), turned, max_angle_deg=10.0)
    assert not found or abs(found.curve.direction[1]) > 0.9


def test_what_is_explained():
    explained = explain_published_localization(
        volume(0.03), expected(0.03), PARAMETERS, np.random.default_rng(0)
    )
    (attempt,) = explained.attempts
    assert len(attempt.candidates) == len(attempt.inliers)
    assert attempt.profile.seen.any()
    assert attempt.measurement is explained.measurement
    nothing = explain_published_localization(
        volume(0.03), NotFound("no needle"), PARAMETERS, np.random.default_rng(0)
    )
    assert nothing.measurement.reason == "no needle"


def test_nelder_and_mead_bend_a_straight_axis():
    rng = np.random.default_rng(1)
    points = NeedleCurve(BENT).position(rng.random(200)) + 0.2e-3 * rng.normal(size=(200, 3))
    straight = axis_through(np.array([BENT[0], BENT[1] * [1, 0, 0], BENT[2]]))
    better = optimize_locally(points, straight, max_bend=0.1)
    assert better.distance(points).mean() < 0.6 * straight.distance(points).mean()
    truth = principal_axis(BENT)
    assert better.distance(points).mean() < 1.1 * truth.distance(points).mean()


def test_the_curvature_stays_below_its_limit():
    rng = np.random.default_rng(1)
    points = NeedleCurve(BENT).position(rng.random(200))
    straight = axis_through(np.array([BENT[0], BENT[1] * [1, 0, 0], BENT[2]]))
    limited = optimize_locally(points, straight, max_bend=0.01)
    a = limited.abscissa(points)
    ends = limited.position(np.linspace(a.min(), a.max(), 3))
    assert relative_sagitta(ends) < 0.011
    assert relative_sagitta(BENT) > 0.03
