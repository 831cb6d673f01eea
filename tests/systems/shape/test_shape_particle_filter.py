import numpy as np
import pytest

from sonoservo.systems.needle.steered_path import SteeredPath, draw_wander
from sonoservo.systems.shape import ShapeParticleFilterParameters, WanderParameters
from sonoservo.systems.shape.shape_particle_filter import ShapeParticleFilter
from sonoservo.systems.shape.shape_posterior import MeasurementNoise, combined_wander
from sonoservo.systems.signals.bicycle_paths import deflections
from sonoservo.systems.signals.curvature_wander import wander_modes
from sonoservo.systems.signals.needle_shape import bicycle_paths, path_statistics

DEPTH, TURN, NOISE = 0.14, 0.06, 0.1e-3


def make_filter(wander, rotations=(TURN,), particles=500):
    return ShapeParticleFilter(
        ShapeParticleFilterParameters(
            depth=DEPTH,
            rotations=list(rotations),
            particles=particles,
            noise=MeasurementNoise(std=NOISE, confidence=1e4, independence=1.0, outlier=100.0),
            wander=wander,
        )
    )


def needle(seed, wander, until, step=1e-3):
    """Measured points of a needle whose curvature wanders, and its true x and y at full depth."""
    rng = np.random.default_rng(seed)
    path = SteeredPath(
        radius=rng.uniform(0.8, 2.4),
        roll=rng.uniform(-3, 3),
        angle=np.deg2rad(rng.uniform(-2, 2)),
        rotations=(TURN,),
        wander=draw_wander(0.16, wander, 0.02, rng),
    )
    along = path.positions(np.linspace(0, 0.147, 500))
    depths = np.append(np.arange(0, until + 1e-9, step), DEPTH)
    across = np.stack([np.interp(depths, along[:, 0], along[:, i]) for i in (1, 2)], axis=-1)
    points = np.column_stack([across, depths])[:-1]
    points[:, :2] += NOISE * rng.normal(size=(len(points), 2))
    return points, across[-1]


def believe(shape_filter, points, seed=0):
    rng = np.random.default_rng(seed)
    belief = shape_filter.begin(rng)
    for point in points:
        belief = shape_filter.update(belief, point, rng)
    return belief


def tip(shape_filter, belief, rotations=(TURN,)):
    """Mean and covariance of the position at full depth."""
    paths = shape_filter.represent(belief, np.random.default_rng(1))
    at = paths.origins + bicycle_paths(paths.parameters, [DEPTH], rotations)[:, 0]
    at += wander_modes(DEPTH, rotations, paths.wander_length).at([DEPTH])[0] @ paths.wander
    mean, covariance = path_statistics(at[:, np.newaxis], paths.weights)
    return mean[0], covariance[0] + paths.origin_variance * np.eye(2)


def test_modes_have_the_variance_of_curvature_integrated_twice():
    depths = np.array([0.03, 0.08, 0.14])
    modes = wander_modes(DEPTH, (TURN,), 0.02).at(depths)
    # Directly, on another grid: u(v) is the integral of (v - t) s(t) kappa(t).
    t = (np.arange(280) + 0.5) * 0.5e-3
    sign = np.where(t < TURN, 1, -1)
    lever = np.maximum(depths[:, np.newaxis] - t, 0) * sign * 0.5e-3
    covariance = lever @ np.exp(-((t[:, np.newaxis] - t) ** 2) / (4 * 0.02**2)) @ lever.T
    np.testing.assert_allclose(modes @ modes.T, covariance, rtol=0.01, atol=1e-3 * covariance.max())


def test_the_posterior_is_the_exact_one_of_the_linear_model():
    # Amplitudes and noise known, and paths so flat that the model is linear.
    wander = WanderParameters(amplitude=0.2, spread=1e-3, across=1e-4, across_spread=1e-3)
    points, _ = needle(5, 0.2, TURN, 2e-3)
    shape_filter = make_filter(wander, particles=2000)
    found = [tip(shape_filter, believe(shape_filter, points))]
    radius = np.linspace(0.3, 3.5, 161)
    plane = np.arctan2(*(points[-1, :2] - points[0, :2])[::-1])
    direction = np.array([np.cos(plane), np.sin(plane)])
    measured, depths = points[:, :2] @ direction, points[:, 2]
    modes = wander_modes(DEPTH, (TURN,), 0.02).at(np.append(depths, DEPTH))
    weights, means, variances = [], [], []
    for r in radius:
        # Origin and first slope are linear; the radius is summed over.
        u = deflections(np.array([[1 / r, 0.0]]), np.append(depths, DEPTH), np.array([TURN]))[0]
        slopes = np.append(depths, DEPTH)
        prior = 1.0 + np.outer(slopes, slopes) * np.deg2rad(5) ** 2
        prior = prior + (0.2 / r) ** 2 * modes @ modes.T
        data = prior[:-1, :-1] + NOISE**2 * np.eye(len(depths))
        solved = np.linalg.solve(data, np.column_stack([measured - u[:-1], prior[:-1, -1]]))
        weights.append(
            -0.5 * (measured - u[:-1]) @ solved[:, 0]
            - 0.5 * np.linalg.slogdet(data)[1]
            - 0.5 * ((r - 1.5) / 0.6) ** 2
        )
        means.append(u[-1] + prior[-1, :-1] @ solved[:, 0])
        variances.append(prior[-1, -1] - prior[-1, :-1] @ solved[:, 1])
    share = np.exp(np.array(weights) - max(weights))
    share /= share.sum()
    mean = share @ means
    std = np.sqrt(share @ (np.array(variances) + (np.array(means) - mean) ** 2))
    assert np.mean([m @ direction for m, _ in found]) == pytest.approx(mean, abs=0.25 * std)
    spread = np.mean([np.sqrt(direction @ c @ direction) for _, c in found])
    assert spread == pytest.approx(std, rel=0.15)


@pytest.mark.parametrize("wander", [0.0, pytest.param(0.3, marks=pytest.mark.slow)])
def test_whole_needles_teach_the_amplitude_for_the_next(wander):
    prior = WanderParameters(amplitude=0.1, spread=1.0, across=0.05, across_spread=1.0)
    shape_filter = make_filter(prior)
    alone = [
        shape_filter.learned_wander(believe(shape_filter, needle(seed, wander, DEPTH, 3e-3)[0]))
        for seed in range(5)
    ]
    learnt = combined_wander(prior, alone)
    if wander:
        assert learnt.amplitude == pytest.approx(wander, rel=0.4)
        assert learnt.spread < 0.4
    else:
        assert learnt.amplitude < 0.06
    assert learnt.across < 0.06
    # Needles that told nothing change nothing.
    nothing = combined_wander(prior, [prior, prior])
    assert (nothing.amplitude, nothing.spread) == pytest.approx((prior.amplitude, prior.spread))
