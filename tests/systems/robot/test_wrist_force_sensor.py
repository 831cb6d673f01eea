import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.tree import JointIndex

from sonoservo.systems.robot import WristForceSensor, WristSensorParameters

FORCES = [SpatialForce(np.full(6, 9.0)), SpatialForce(np.arange(6.0))]


QUIET = {"force_noise": 0.0, "torque_noise": 0.0}


def readings(times, *, seed=3, **parameters):
    sensor = WristForceSensor(
        wrist=JointIndex(1), parameters=WristSensorParameters(**parameters), period=0.005, seed=seed
    )
    context = sensor.CreateDefaultContext()
    sensor.get_input_port().FixValue(context, Value[list[SpatialForce]](FORCES))
    read = []
    for time in times:
        context.SetTime(time)
        force = sensor.get_output_port().Eval(context)
        read.append(np.concatenate([force.rotational(), force.translational()]))
    return np.array(read)


def test_noise_has_the_given_deviation_and_no_memory():
    noise = readings(0.005 * np.arange(4000)) - np.arange(6.0)
    np.testing.assert_allclose(noise.std(axis=0), 3 * [0.001] + 3 * [0.02], rtol=0.05)
    assert (np.abs(noise.mean(axis=0)) < 4 * noise.std(axis=0) / np.sqrt(4000)).all()
    for column in noise.T:
        assert abs(np.corrcoef(column[1:], column[:-1])[0, 1]) < 0.06
    assert np.abs(np.corrcoef(noise.T) - np.eye(6)).max() < 0.06


def test_noise_depends_on_time_and_seed_alone():
    forward = readings([0.0, 0.005, 0.010])
    np.testing.assert_array_equal(readings([0.010, 0.005, 0.0])[::-1], forward)
    np.testing.assert_array_equal(readings([0.005, 0.006])[0], readings([0.006])[0])
    assert np.abs(readings([0.0], seed=4) - forward[0]).max() > 1e-4


def test_bias_is_constant_and_drift_grows_with_time():
    bias = {"force_bias": 0.3, "torque_bias": -0.01}
    drift = {"force_drift": 2e-3, "torque_drift": 1e-4}
    read = readings([0.0, 50.0], **QUIET, **bias, **drift) - np.arange(6.0)
    np.testing.assert_allclose(read[0], 3 * [-0.01] + 3 * [0.3])
    np.testing.assert_allclose(read[1] - read[0], 3 * [0.005] + 3 * [0.1])
