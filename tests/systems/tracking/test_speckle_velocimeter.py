"""The tip's velocity from speckle that is displaced exactly."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.radio_frequency_sweep import RadioFrequencySweep
from sonoservo.systems.signals.sweep import SweepGeometry, SweepMotion
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.speckle_velocimeter import (
    SpeckleVelocimeter,
    SpeckleVelocimeterParameters,
    measure_velocity,
)

SHAPE = (41, 35, 33)
SPACING = np.array([0.7e-3, 0.5e-3, 0.6e-3])
X_WP = RigidTransform(RollPitchYaw(0.3, -0.5, 1.1), [0.2, -0.1, 0.4])
DIRECTION = X_WP.rotation().matrix() @ np.array([0.8, 0.6, 0.0])
PARAMETERS = SpeckleVelocimeterParameters(kernel=[11, 9, 9], search=[17, 15, 15])
TIP = X_WP @ (SPACING * (20, 17, 16))


def speckle(displacement, seed=0):
    """Band-limited noise, displaced exactly by a number of voxels: a sum of waves."""
    rng = np.random.default_rng(seed)
    waves = 0.6 * rng.normal(size=(150, 3))
    amplitudes = np.exp(1j * (rng.uniform(0, 2 * np.pi, 150) - waves @ displacement))
    factors = [np.exp(1j * np.outer(np.arange(m), w)) for m, w in zip(SHAPE, waves.T, strict=True)]
    return np.einsum("im,jm,km,m->ijk", *factors, amplitudes, optimize=True).real


def volume(time, displacement=(0, 0, 0), seed=0):
    values = np.clip(128 + 5 * speckle(np.array(displacement), seed), 0, 255).astype(np.float32)
    return Volume(values, np.zeros(3), SPACING, X_WP, time)


@pytest.mark.parametrize("displacement", [(0, 0, 0), (-1.3, 1.8, -0.5)])
def test_measures_the_velocity_in_the_world(displacement):
    found = measure_velocity(
        volume(0.5, displacement), volume(0.0), TIP, TIP, DIRECTION, PARAMETERS
    )
    assert isinstance(found, VelocityMeasurement)
    true = X_WP.rotation().matrix() @ (SPACING * displacement) / 0.5
    # A tenth of a voxel in half a second.
    np.testing.assert_allclose(found.velocity, true, atol=0.14e-3)
    assert 0.9 < found.correlation <= 1
    assert np.linalg.eigvalsh(found.covariance)[0] > 0


def test_the_search_is_centred_on_the_prediction():
    moved = (7.2, 0.4, 0.0)
    current, previous = volume(0.5, moved), volume(0.0)
    true = X_WP.rotation().matrix() @ (SPACING * moved)
    assert not measure_velocity(current, previous, TIP, TIP, DIRECTION, PARAMETERS)
    found = measure_velocity(current, previous, TIP, TIP + true, DIRECTION, PARAMETERS)
    np.testing.assert_allclose(found.velocity, true / 0.5, atol=0.14e-3)


def test_only_what_lies_along_the_needle_may_be_kept():
    along = dataclasses.replace(PARAMETERS, along_axis=True)
    current, previous = volume(0.5, (1.2, 0.3, 0.8)), volume(0.0)
    whole = measure_velocity(current, previous, TIP, TIP, DIRECTION, PARAMETERS).velocity
    found = measure_velocity(current, previous, TIP, TIP, DIRECTION, along).velocity
    np.testing.assert_allclose(found, (whole @ DIRECTION) * DIRECTION, atol=1e-12)
    assert np.linalg.norm(whole - found) > 0.5e-3


def test_covariance_is_that_of_the_elements_in_the_world():
    parameters = dataclasses.replace(PARAMETERS, min_speed_std=0.0)
    found = measure_velocity(volume(0.5), volume(0.0), TIP, TIP, DIRECTION, parameters)
    R = X_WP.rotation().matrix()
    expected = R @ np.diag((np.array(parameters.displacement_std) * SPACING / 0.5) ** 2) @ R.T
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-6, atol=1e-15)


@pytest.mark.parametrize(
    ("current", "tip", "reason"),
    [
        (volume(0.5, seed=1), TIP, "the speckle has changed"),
        (volume(0.5), X_WP @ (SPACING * (2, 17, 16)), "beyond the volume"),
        (volume(0.0), TIP, "at the same time"),
        (Volume(np.full(SHAPE, 7, np.uint8), np.zeros(3), SPACING, X_WP, 0.5), TIP, "resembles"),
        (volume(0.5, (2.0, 0.0, 0.0)), TIP, "1.4 mm away"),
    ],
)
def test_says_why_there_is_no_velocity(current, tip, reason):
    near = dataclasses.replace(PARAMETERS, max_distance=1e-3 if "away" in reason else 5e-3)
    found = measure_velocity(current, volume(0.0), tip, tip, DIRECTION, near)
    assert not found
    assert reason in found.reason


GEOMETRY = SweepGeometry(0.0, 0.0, 0.01, 0.013, 2.8519e-5, 41, 15, 1800, 0.01)


def radio_frequency(time, samples_moved):
    """Noise on a carrier of 3.6 samples a period, moved in depth by a fraction of a sample."""
    rng = np.random.default_rng(0)
    frequencies = rng.normal(2 * np.pi / 3.6, 0.4, 60)
    phases = rng.uniform(0, 2 * np.pi, (GEOMETRY.frames, GEOMETRY.lines, 60))
    lines = np.zeros(GEOMETRY.shape, np.float32)
    i = np.arange(1500, 1750)
    waves = np.exp(1j * np.outer(frequencies, i - samples_moved))
    lines[..., 1500:1750] = (np.exp(1j * phases) @ waves).real
    poses = np.repeat(np.eye(4)[np.newaxis], GEOMETRY.frames, axis=0)
    return RadioFrequencySweep(
        lines, SweepMotion(GEOMETRY, 1, np.full(GEOMETRY.frames, time), poses)
    )


PUBLISHED = SpeckleVelocimeterParameters(kernel=[7, 21, 51], search=[11, 37, 61])


@pytest.mark.parametrize(("samples_moved", "envelope"), [(1.2, True), (-2.3, False)])
def test_radio_frequency_lines_show_motion_in_depth(samples_moved, envelope):
    parameters = dataclasses.replace(PUBLISHED, envelope=envelope)
    current, previous = radio_frequency(1.0, samples_moved), radio_frequency(0.0, 0.0)
    tip = previous.position([7, 20, 1625])
    found = measure_velocity(current, previous, tip, tip, DIRECTION, parameters)
    depth = tip / np.linalg.norm(tip)
    expected = samples_moved * GEOMETRY.sample_pitch * depth
    np.testing.assert_allclose(found.velocity, expected, atol=0.2 * GEOMETRY.sample_pitch)


def expected_at(time, tip, velocity):
    curve = NeedleCurve([tip - 0.02 * DIRECTION, tip])
    return NeedlePrediction(2, time, curve, [np.zeros(3), velocity], np.eye(6), curve.entry)


AT_REST = expected_at(0.0, TIP, np.zeros(3))


def velocity_of(current, previous, prediction):
    leaf = SpeckleVelocimeter(measure=partial(measure_velocity, parameters=PARAMETERS))
    context = leaf.CreateDefaultContext()
    ports = {"volume": current, "previous_volume": previous, "prediction": prediction}
    for port, value in ports.items():
        leaf.GetInputPort(port).FixValue(context, Value[object](value))
    return leaf.GetOutputPort("velocity").Eval(context)


def test_leaf_predicts_the_tip_both_ways_from_its_prediction():
    moved = (7.2, 0.4, 0.0)
    velocity = X_WP.rotation().matrix() @ (SPACING * moved) / 0.5
    # The prediction is of a time between the volumes.
    prediction = expected_at(0.2, TIP + 0.2 * velocity, velocity)
    found = velocity_of(volume(0.5, moved), volume(0.0), prediction)
    np.testing.assert_allclose(found.velocity, velocity, atol=0.14e-3)


@pytest.mark.parametrize(
    ("current", "previous", "prediction", "reason"),
    [
        (NotFound("no volume yet"), volume(0.0), AT_REST, "no volume yet"),
        (volume(0.5), NotFound("none before"), AT_REST, "none before"),
        (volume(0.5), volume(0.0), NotFound("nothing is expected"), "no needle"),
        (volume(0.5), volume(0.0), NeedlePrediction(2, 0.5, everywhere=True), "no needle"),
        (volume(0.5), radio_frequency(0.0, 0.0), AT_REST, "another kind"),
    ],
)
def test_leaf_says_what_is_missing(current, previous, prediction, reason):
    found = velocity_of(current, previous, prediction)
    assert not found
    assert reason in found.reason


@pytest.mark.parametrize(
    ("field", "value"),
    [("kernel", [11, 8, 9]), ("search", [9, 15, 15]), ("displacement_std", [0.1, 0.1, 0.0])],
)
def test_impossible_parameters_are_refused(field, value):
    with pytest.raises(ValueError, match=field):
        dataclasses.replace(PARAMETERS, **{field: value})
