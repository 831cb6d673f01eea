import numpy as np
import pytest
from bicycle_model import BicyclePath
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix
from scipy.stats import chi2

from sonoservo.diagrams.experiments.shape_prediction_scenario import SHAPE_FILTERS
from sonoservo.systems.shape import ShapeEstimator, ShapeEstimatorParameters, WanderParameters
from sonoservo.systems.shape.shape_filter import ShapePaths
from sonoservo.systems.shape.shape_posterior import MeasurementNoise
from sonoservo.systems.signals import CrossSection, NeedleShape, NotFound

X_WI = RigidTransform(RotationMatrix.MakeYRotation(1.2), [0.3, -0.1, 0.2])
SOUND = ("particle_filter", "least_squares")
ALL = tuple(SHAPE_FILTERS)


def make_filter(name, **values):
    choice = SHAPE_FILTERS[name]
    if name in SOUND:
        values.setdefault("noise", MeasurementNoise(std=0.1e-3, independence=1.0))
    if name == "particle_filter":
        # These paths have a constant curvature; test_wandering_curvature.py has others.
        values.setdefault("wander", WanderParameters(amplitude=0.0))
    return choice.make(choice.parameters(**values))


def cross_section(p_I, time):
    X_WP = X_WI @ RigidTransform([0, 0, p_I[2]])
    return CrossSection(
        position=X_WI.multiply(np.array(p_I)),
        X_WP=X_WP.GetAsMatrix4(),
        time=time,
        correlation=0.9,
        centre=p_I[:2],
        template=np.zeros((3, 3), np.float32),
    )


def estimate(name, points, seed=0, **values):
    shape_filter = make_filter(name, **values)
    return shapes_of(ShapeEstimator(shape_filter=shape_filter, period=1.0, seed=seed), points)


def shapes_of(estimator, points):
    """The shapes after each point, by the leaf's own events."""
    context = estimator.CreateDefaultContext()
    shapes = []
    for number, p_I in enumerate(points):
        found = cross_section(p_I, float(number)) if np.isfinite(p_I[0]) else NotFound("no echo")
        estimator.GetInputPort("cross_section").FixValue(context, Value[object](found))
        estimator.ExecuteForcedEvents(context)
        shapes.append(estimator.GetOutputPort("shape").Eval(context))
    return shapes


def measured(path, depths, deviation, seed=0):
    """Points in I; the first one's plane is that of the first slice, at depth 0."""
    points = path.position(depths)
    points[:, :2] += deviation * np.random.default_rng(seed).normal(size=(len(depths), 2))
    return points


@pytest.mark.parametrize("name", SOUND)
def test_little_noise_gives_the_path_beyond_the_rotation(name):
    path = BicyclePath(radius=1.2, angle=-0.02, plane=-2.0, rotations=(0.06,))
    points = measured(path, np.arange(0, 0.0601, 1e-3), 5e-6)
    noise = MeasurementNoise(std=5e-6, independence=1.0)
    shape = estimate(name, points, depth=0.14, rotations=[0.06], noise=noise)[-1]
    depths = np.linspace(0, 0.14, 15)
    mean, _ = shape.predict(depths)
    assert np.linalg.norm(mean - path.position(depths)[:, :2], axis=1).max() < 0.03e-3
    assert np.allclose(shape.tip, X_WI.multiply(path.position(0.14)), atol=0.03e-3)
    assert shape.observed == pytest.approx(0.06)


@pytest.mark.parametrize("name", SOUND)
def test_error_and_stated_uncertainty_agree(name):
    distances, errors, stated = [], [], []
    rng = np.random.default_rng(4)
    for seed in range(8):
        path = BicyclePath(
            radius=rng.normal(1.5, 0.3), angle=rng.normal(0, 0.04),
            plane=rng.uniform(-3, 3), rotations=(0.06,),
        )  # fmt: skip
        points = measured(path, np.arange(0, 0.0601, 3e-3), 0.1e-3, seed)
        shape = estimate(name, points, seed, depth=0.14, rotations=[0.06])[-1]
        mean, covariance = shape.predict([0.14])
        error = mean[0] - path.position(0.14)[:2]
        distances.append(error @ np.linalg.solve(covariance[0], error))
        errors.append(error @ error)
        stated.append(np.trace(covariance[0]))
    # Mean squared error over stated variance: two directions of unequal variance.
    assert 0.5 < np.mean(errors) / np.mean(stated) < 2.0
    assert np.mean(np.array(distances) < chi2.ppf(0.95, 2)) > 0.85


@pytest.mark.parametrize("name", SOUND)
def test_fewer_slices_than_parameters_are_wide_not_wrong(name):
    path = BicyclePath(radius=0.8, angle=0.05, plane=1.0)
    points = measured(path, np.array([0.0, 1e-3, 2e-3, 3e-3]), 0.1e-3)
    shapes = estimate(name, points, depth=0.1)
    for shape in shapes:
        mean, covariance = shape.predict([0.1])
        error = mean[0] - path.position(0.1)[:2]
        assert error @ np.linalg.solve(covariance[0], error) < chi2.ppf(0.999, 2)
        assert np.sqrt(np.trace(covariance[0])) > 2e-3
    # The more is seen, the narrower.
    shapes = estimate(name, measured(path, np.arange(0, 0.08, 2e-3), 0.1e-3), depth=0.1)
    deviation = [shape.std([0.1])[0] for shape in shapes]
    assert deviation[-1] < 0.1 * deviation[5] < 0.1 * deviation[1] * 2


@pytest.mark.parametrize("name", SOUND)
def test_echoes_of_something_else_widen_the_uncertainty(name):
    path = BicyclePath(radius=1.5, angle=0.0, plane=0.0)
    points = measured(path, np.arange(0, 0.05, 1e-3), 0.1e-3)
    clean = estimate(name, points, depth=0.1)[-1]
    points[20:24, 1] += 2e-3
    hit = estimate(name, points, depth=0.1)[-1]
    error = np.linalg.norm(hit.predict([0.1])[0][0] - path.position(0.1)[:2])
    assert error < 1e-3
    assert hit.std([0.1])[0] > 1.2 * clean.std([0.1])[0]


@pytest.mark.parametrize("name", ALL)
def test_slices_without_needle_beyond_the_limit_or_seen_before_change_nothing(name):
    path = BicyclePath(radius=1.0, angle=0.02)
    depths = np.arange(0, 0.03, 0.5e-3)
    points = measured(path, depths, 0.1e-3)
    expected = estimate(name, points, depth=0.1, observe_until=0.02)
    at = int(np.searchsorted(depths, 0.02 + 1e-6))
    assert np.array_equal(expected[at].tip, expected[-1].tip)
    assert expected[-1].observed == pytest.approx(0.02)
    points[at - 5] = np.nan
    missing = estimate(name, points[: at - 4], depth=0.1)
    assert missing[-1].reason == "no echo"
    assert np.array_equal(missing[-1].tip, missing[-2].tip)


def test_the_printed_filter_waits_for_10_mm_and_loses_its_spread():
    path = BicyclePath(radius=1.5, angle=0.03)
    points = measured(path, np.arange(0, 0.0601, 0.5e-3), 0.1e-3)
    shapes = estimate("published", points, depth=0.14, bevel_direction_deg=0.0, gain=0.3)
    assert all(isinstance(shape, NotFound) for shape in shapes[:20])
    assert "10 mm" in shapes[10].reason
    first, last = shapes[20], shapes[-1]
    assert isinstance(first, NeedleShape)
    # 100 steps, each of which shrinks the spread by 0.3 whatever was measured.
    assert last.std([0.14])[0] < 0.01 * first.std([0.14])[0]
    error = np.linalg.norm(last.predict([0.14])[0][0] - path.position(0.14)[:2])
    assert error > 5 * last.std([0.14])[0]


class MeanFilter:
    """A filter of one's own: straight needles along Z at the mean of the points."""

    parameters = ShapeEstimatorParameters(depth=0.1)

    def begin(self, rng):
        return np.zeros((0, 3))

    def update(self, belief, point, rng):
        return np.vstack([belief, point])

    def represent(self, belief, rng):
        return ShapePaths(
            parameters=np.array([[1e9, 0.0, 0.0]]),
            origins=belief[:, :2].mean(axis=0)[np.newaxis],
            weights=np.ones(1),
        )


def test_a_filter_of_ones_own_fits_in_a_given_frame():
    estimator = ShapeEstimator(shape_filter=MeanFilter(), X_WI=X_WI, period=1.0)
    shape = shapes_of(estimator, np.array([[1e-3, 0, 5e-3], [3e-3, 0, 6e-3]]))[-1]
    assert np.allclose(X_WI.inverse().multiply(shape.tip), [2e-3, 0, 0.1])


@pytest.mark.parametrize("breath", [0.0, 0.5e-3], ids=["rests", "breathes"])
def test_tissue_that_breathes_is_no_needle_that_bends(breath):
    """The shift's wave is as long as that of a breath of 4 s while a needle goes 10 mm/s."""
    depths, path = np.arange(0, 0.06, 1.5e-3), BicyclePath(radius=1.2, rotations=(0.06,))
    errors = {1: [], 3: []}
    for phase in (0, 2, 4) if breath else (0,):
        points = measured(path, depths, 0.1e-3)
        points[:, 0] += breath * np.sin(2 * np.pi * depths / 0.04 + phase)
        for levels in ([0.0], [0.0, 0.2e-3, 0.5e-3]):
            # As in tissue, the curvature may wander.
            values = {"rotations": [0.06], "shift_stds": levels, "wander": WanderParameters()}
            shape = estimate("particle_filter", points, **values)[-1]
            mean, covariance = shape.predict(np.array([0.14]))
            off = mean[0] - path.position(0.14)[:2]
            errors[len(levels)].append(np.linalg.norm(off))
        assert off @ np.linalg.solve(covariance[0], off) < chi2.ppf(0.99, 2)
    without, with_shift = np.mean(errors[1]), np.mean(errors[3])
    assert with_shift < (0.7 * without if breath else 1.2 * without)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rotations": [0.2]}, "within the insertion"),
        ({"rotations": [0.06, 0.05]}, "ascending order"),
    ],
)
def test_bad_parameters_are_named(changes, message):
    with pytest.raises(ValueError, match=message):
        ShapeEstimatorParameters(**changes)
