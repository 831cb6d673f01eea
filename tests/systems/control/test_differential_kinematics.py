import numpy as np
import pytest
from pydrake.math import RotationMatrix
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsParameters,
    DoDifferentialInverseKinematics,
)
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.analysis import Simulator

from sonoservo.diagrams import assemble_arm
from sonoservo.systems.control import DifferentialKinematics, DifferentialKinematicsParameters

STEP = 0.005
ELBOW_UP = assemble_arm().home


class Bench:
    """The leaf on its own, with a plant of its own to look at where its command leads."""

    def __init__(self, q, *, planar=(0, 0, 0), approach=0.0, arm="viper_s850", **parameters):
        self.arm = assemble_arm(arm)
        self.plant = self.arm.plant
        self.context = self.plant.CreateDefaultContext()
        leaf = DifferentialKinematics(
            parameters=DifferentialKinematicsParameters(**parameters),
            plant=self.plant,
            probe=self.arm.probe.body_frame(),
            time_step=STEP,
        )
        self.simulator = Simulator(leaf)
        root = self.simulator.get_mutable_context()
        leaf.GetInputPort("planar_velocity").FixValue(root, planar)
        leaf.GetInputPort("approach_velocity").FixValue(root, [approach])
        leaf.GetInputPort("joint_state").FixValue(root, np.concatenate([q, np.zeros_like(q)]))
        self.simulator.Initialize()
        self.leaf = leaf

    def command(self):
        return self.leaf.GetOutputPort("joint_command").Eval(self.simulator.get_context())

    def pose(self, q):
        self.plant.SetPositions(self.context, q)
        return self.arm.probe.EvalPoseInWorld(self.context)

    def jacobian(self, q):
        self.plant.SetPositions(self.context, q)
        frame, W = self.arm.probe.body_frame(), self.plant.world_frame()
        return self.plant.CalcJacobianSpatialVelocity(
            self.context, JacobianWrtVariable.kV, frame, np.zeros(3), W, frame
        )


def test_probe_moves_as_asked():
    bench = Bench(ELBOW_UP, planar=(0.02, -0.01, 0.3), approach=0.015)
    before = bench.pose(ELBOW_UP)
    bench.simulator.AdvanceTo(0.5)
    after = bench.pose(bench.command()[:6])
    time = 0.5
    change = before.inverse() @ after
    turn = RotationMatrix.MakeYRotation(0.3 * time).matrix()
    np.testing.assert_allclose(change.rotation().matrix(), turn, atol=1e-4)
    w = 0.3
    x = 0.02 * np.sin(w * time) / w + -0.01 * (1 - np.cos(w * time)) / w
    z = -0.01 * np.sin(w * time) / w - 0.02 * (1 - np.cos(w * time)) / w
    np.testing.assert_allclose(change.translation(), [x, 0.015 * time, z], atol=2e-5)


def test_command_ramps_between_updates():
    bench = Bench(ELBOW_UP, planar=(0.02, 0, 0))
    bench.simulator.AdvanceTo(0.0501)
    first = bench.command()
    bench.simulator.AdvanceTo(0.0541)
    second = bench.command()
    np.testing.assert_array_equal(first[6:], second[6:])
    np.testing.assert_allclose(second[:6] - first[:6], 0.004 * first[6:], atol=1e-15)
    assert np.abs(first[6:]).max() > 1e-3


def test_joint_velocity_limits_slow_but_do_not_turn_the_motion():
    bench = Bench(ELBOW_UP, planar=(2.0, 1.0, 0), axis_gain=0.0)
    bench.simulator.AdvanceTo(0.0075)
    q, v = np.split(bench.command(), 2)
    limits = bench.plant.GetVelocityUpperLimits()
    assert (np.abs(v) <= limits + 1e-6).all()
    assert (np.abs(v) >= limits - 1e-6).any()
    V = bench.jacobian(q - 0.0025 * v) @ v
    wanted = np.array([0, 0, 0, 2.0, 0, 1.0])
    alpha = V @ wanted / (wanted @ wanted)
    assert 0 < alpha < 1
    np.testing.assert_allclose(V, alpha * wanted, atol=1e-4)


def test_joint_position_limits_hold():
    q = ELBOW_UP.copy()
    upper = assemble_arm().plant.GetPositionUpperLimits()[5]
    q[5] = upper - 0.01
    bench = Bench(q, planar=(0, 0, 1.0))
    bench.simulator.AdvanceTo(0.2)
    assert bench.command()[5] == pytest.approx(upper, abs=1e-3)
    assert bench.command()[5] <= upper + 1e-6


def test_two_contexts_of_one_system_do_not_disturb_each_other():
    bench = Bench(ELBOW_UP)
    context = bench.simulator.get_context()
    contexts = [context, bench.leaf.CreateDefaultContext(), context.Clone()]
    assert len({id(bench.leaf._scratch(each)) for each in contexts}) == 3


IIWA = assemble_arm("lbr_iiwa_14").home
ASIDE = IIWA + np.array([0.1, -0.05, 0.2, 0.1, -0.1, 0.05, 0.3])


@pytest.mark.parametrize(("arm", "q"), [("viper_s850", ELBOW_UP), ("lbr_iiwa_14", ASIDE)])
def test_direct_solution_is_drakes(arm, q):
    bench, n = Bench(q, arm=arm, planar=(0.02, -0.01, 0.3), axis_gain=0.0), len(q)
    bench.simulator.AdvanceTo(STEP / 2)
    limits = DifferentialInverseKinematicsParameters(n, n)
    limits.set_time_step(STEP)
    J, v = bench.jacobian(q), bench.command()[n:]
    if n == 7:
        limits.set_nominal_joint_position(IIWA)
        limits.set_joint_centering_gain(0.5 * np.eye(7))
        null = np.linalg.svd(J)[2][-1]
        assert null @ v == pytest.approx(0.5 * null @ (IIWA - q), abs=1e-9)
    wanted = np.array([0, 0.3, 0, 0.02, 0, -0.01])
    np.testing.assert_allclose(J @ v, wanted, atol=1e-9)
    result = DoDifferentialInverseKinematics(q, np.zeros(n), wanted, J, limits)
    np.testing.assert_allclose(v, result.joint_velocities, atol=1e-3)


def test_probes_axis_comes_back_to_the_vertical():
    q = ELBOW_UP + np.array([0, 0, 0, 0.02, 0.03, 0])
    bench = Bench(q, planar=(0, 0, 0.1), axis_gain=2.0)
    tilted = bench.pose(q).rotation().matrix()[:, 1]
    assert np.arccos(-tilted[2]) > 0.03
    bench.simulator.AdvanceTo(4)
    axis = bench.pose(bench.command()[:6]).rotation().matrix()[:, 1]
    assert np.hypot(axis[0], axis[1]) < 0.03 * np.exp(-2 * 4) * 1.5
    np.testing.assert_allclose(axis[2], -1, atol=1e-6)


def test_an_arm_stretched_out_stays_finite():
    q = np.deg2rad([0, -90, 90, 0, 0, 0])
    bench = Bench(q, planar=(0.01, 0, 0.2), approach=0.01)
    bench.simulator.AdvanceTo(0.05)
    assert np.isfinite(bench.command()).all()
    assert (np.abs(bench.command()[6:]) <= bench.plant.GetVelocityUpperLimits() + 1e-6).all()


def test_an_axis_without_a_direction_is_refused():
    with pytest.raises(ValueError, match="axis"):
        DifferentialKinematicsParameters(axis=[0.0, 0.0, 0.0])
