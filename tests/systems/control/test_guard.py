import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.analysis import Simulator

from sonoservo.diagrams import assemble_arm
from sonoservo.systems.control import Guard, GuardParameters
from sonoservo.systems.robot import load_arm
from sonoservo.systems.signals import GuardState

STEP = 0.005
ARM = assemble_arm()
HOME = ARM.home
N = len(HOME)
SCRATCH = ARM.plant.CreateDefaultContext()


def pose(q):
    ARM.plant.SetPositions(SCRATCH, q)
    return ARM.probe.body_frame().CalcPoseInWorld(SCRATCH)


class Rig:
    """A guard between a controller, its instruments and a perfect arm, as a test sets them."""

    def __init__(self, two_witnesses):
        X = pose(HOME)
        self.velocity, self.pressing, self.shift = np.zeros(N), 0.0, np.zeros(3)
        self.q, self.frozen, self.felt_by_arm = HOME.copy(), None, None
        self.silent, self.sample, self.confirmations = False, None, 0
        self._two = two_witnesses
        self.guard = Guard(
            parameters=GuardParameters(), plant=ARM.plant, probe=ARM.frame,
            mass=ARM.probe.default_mass(), axis=X.rotation().matrix()[:, 1],
            surface=X.translation(), time_step=STEP,
            torque_error=load_arm("viper_s850").torque_error,
        )  # fmt: skip
        self.simulator = Simulator(self.guard)
        self.context = self.simulator.get_mutable_context()
        self.see()
        self.simulator.Initialize()

    @property
    def wanted(self):
        return np.concatenate([self.q + STEP * self.velocity, self.velocity])

    def see(self):
        time, X = self.context.get_time(), pose(self.q)
        noise = np.random.default_rng(round(1e6 * time)).standard_normal(6)
        sample = 0.01 * noise
        sample[3:] += ARM.probe.default_mass() * 9.81 * X.rotation().matrix()[2]
        sample[4] += self.pressing
        self.sample = self.sample if self.silent else sample
        force = self.pressing if self.felt_by_arm is None else self.felt_by_arm
        W = ARM.plant.world_frame()
        J = ARM.plant.CalcJacobianSpatialVelocity(
            SCRATCH, JacobianWrtVariable.kV, ARM.frame, np.zeros(3), W, ARM.frame
        )
        X = self.frozen or RigidTransform(X.rotation(), X.translation() + 1e-9 * np.sin(1e3 * time))
        values = {
            "wanted_command": self.wanted, "joint_state": [*self.q, *np.zeros(N)],
            "confirmation": [self.confirmations], "wrist_force": SpatialForce(self.sample),
            "X_WP": RigidTransform(X.rotation(), X.translation() + self.shift),
        }  # fmt: skip
        if self._two:
            values["external_torque"] = J[3:].T @ [0, -force, 0] + 1e-3 * noise[:N]
        for name, value in values.items():
            self.guard.GetInputPort(name).FixValue(self.context, value)

    def run(self, seconds):
        end = self.context.get_time() + seconds
        while (time := self.context.get_time()) < end - 1e-12:
            self.see()
            following = STEP * (np.floor(time / STEP + 1e-9) + 1)
            self.simulator.AdvanceTo(min(following, end))
            if following < end + 1e-12:
                self.q = self.output("joint_command")[:N].copy()
        return self.status

    def output(self, name):
        return self.guard.GetOutputPort(name).Eval(self.context)

    @property
    def status(self):
        return self.output("guard")


@pytest.fixture
def rig(request):
    return Rig(getattr(request, "param", True))


either = pytest.mark.parametrize("rig", [True, False], indirect=True, ids=["two", "alone"])
"""With the arm's torques as a second witness of the force, and without."""


def test_commands_pass_bit_for_bit_while_nothing_is_wrong(rig):
    rig.velocity = 0.01 * np.arange(1, N + 1)
    for _ in range(8):
        status = rig.run(0.0131)
        rig.see()
        assert (rig.output("joint_command") == rig.wanted).all()
    assert (status.state, status.reason, status.interventions) == (GuardState.MONITORING, "", 0)


@either
def test_too_much_force_makes_the_probe_retreat_hold_and_go_on(rig):
    rig.run(0.1)
    before = pose(rig.q)
    for rig.pressing in (*range(10), 12.0):
        status = rig.run(STEP)
    assert status.state is GuardState.MONITORING
    status = rig.run(2 * STEP)
    assert status.state is GuardState.RETREATING
    assert rig.output("acting")[0] == 1
    assert "contact force exceeds 10 N" in status.reason
    assert "12.0 N" in status.reason
    rig.run(0.03)
    for rig.pressing, seconds in ((6.0, STEP), (0.0, 0.25)):
        status = rig.run(seconds)
    assert status.state is GuardState.HOLDING
    moved = before.inverse() @ pose(rig.q)
    assert moved.translation()[1] == pytest.approx(-GuardParameters().clearance, abs=2e-3)
    assert np.abs(moved.translation()[[0, 2]]).max() < 1e-3
    assert np.abs(rig.output("joint_command")[N:]).max() == 0
    status = rig.run(0.3)
    assert status.state is GuardState.MONITORING
    assert rig.output("acting")[0] == 0
    assert status.interventions == 1
    rig.pressing = 12.0
    assert rig.run(0.05).stopped
    rig.pressing = 0.0
    rig.simulator.Initialize()
    assert (rig.status.stopped, rig.status.interventions) == (False, 0)


def test_a_hard_landing_slows_the_approach_until_a_calm_contact(rig):
    rig.run(0.1)
    assert rig.output("approach_scale")[0] == 1
    for rig.pressing in np.linspace(0.0, 12.0, 13):
        rig.run(STEP)
    rig.run(2 * STEP)
    assert rig.output("approach_scale")[0] == 0.5
    for rig.pressing, seconds, scale in ((0.0, 1.0, 0.5), (1.0, 1.0, 0.5), (1.0, 1.5, 1.0)):
        assert not rig.run(seconds).stopped or rig.pressing == 0
        assert rig.output("approach_scale")[0] == scale


def test_a_sensor_that_was_wrong_three_times_needs_a_person(rig):
    waits = []
    for number in range(3):
        rig.pressing, rig.felt_by_arm = -3.0, 0.0
        assert rig.run(0.3).stopped
        rig.pressing = 0.0
        waits.append(0.0)
        while rig.status.stopped and waits[-1] < 7:
            rig.run(0.1)
            waits[-1] += 0.1
        assert rig.status.interventions == number + 1
    assert waits[0] < 1 < 4.5 < waits[1] < 6 < waits[2]
    assert "a person must confirm" in rig.status.reason
    rig.confirmations = 1
    assert not rig.run(0.1).stopped


def test_contact_in_which_the_witnesses_agree_ends_the_doubt(rig):
    for _ in range(2):  # a second doubt would have to wait for 5 s
        rig.pressing, rig.felt_by_arm = -3.0, 0.0
        assert rig.run(0.3).stopped
        rig.pressing, rig.felt_by_arm = 0.0, None
        assert not rig.run(1.0).stopped
        for rig.pressing in np.linspace(0, 2, 21):
            rig.run(STEP)
        assert not rig.run(1.5).stopped


def test_the_body_that_comes_after_a_held_probe_makes_it_retreat_again(rig):
    rig.run(0.1)
    rig.shift = np.array([0.02, 0, 0])
    assert rig.run(0.1).state is GuardState.HOLDING
    before = pose(rig.q)
    for rig.pressing in (*np.linspace(0, 7, 30), 7.0, 7.0, 7.0):
        rig.run(STEP)
    rig.run(0.05)
    rig.pressing = 0.0
    rig.run(0.3)
    moved = before.inverse() @ pose(rig.q)
    assert moved.translation()[1] < -0.9 * GuardParameters().clearance


@pytest.mark.parametrize(
    ("velocity", "reason"),
    [
        (np.full(N, np.nan), "is not a number"),
        (np.full(N, 5.0), "limit of the joints' positions, speeds or accelerations"),
        (np.r_[0.7, np.zeros(N - 1)], "commanded to move faster"),
        (np.r_[0.44, np.zeros(N - 1)], "commanded to accelerate at more"),
    ],
)
def test_a_command_that_breaks_a_limit_stops_the_arm(rig, velocity, reason):
    rig.run(0.05)
    if "commanded" in reason:  # with and without too much acceleration
        rig.velocity = velocity * (0.5 if "move" in reason else -0.8)
        rig.run(0.04)
        assert not rig.status.stopped
    rig.velocity = velocity
    status = rig.run(0.1)
    assert status.state is GuardState.HOLDING
    assert reason in status.reason
    assert np.isfinite(rig.output("joint_command")).all()
    resting = rig.q.copy()
    rig.run(0.1)
    np.testing.assert_allclose(rig.q, resting, atol=1e-9)
    rig.velocity = np.zeros(N)
    assert rig.run(0.3).state is GuardState.MONITORING


def test_repeated_samples_and_small_steps_of_the_force_are_noted(rig):
    assert rig.run(0.2).remark == ""
    rig.silent = True
    rig.run(4 * STEP)
    rig.silent = False
    rig.run(0.1)
    rig.pressing = 0.8
    rig.run(0.1)
    status = rig.run(0.1)
    assert status.interventions == 0
    assert "steps of the force by more than 0.5 N between samples: 1" in status.remark
    assert "samples of the wrist sensor that repeated the one before: 4" in status.remark
    rig.simulator.Initialize()
    assert rig.status.remark == ""


@pytest.mark.parametrize("moves", [True, False])
def test_a_frozen_pose_stops_a_probe_that_moves_and_is_noted_at_rest(rig, moves):
    assert rig.run(0.2).remark == ""
    rig.velocity = np.r_[0.02 * moves, np.zeros(N - 1)]
    rig.frozen = pose(rig.q)
    status = rig.run(0.3)
    assert status.stopped == moves
    assert ("pose of the probe is frozen" in status.reason) == moves
    assert "measured poses that repeated the one before: " in status.remark
    repeated = int(status.remark.rpartition(" ")[2])
    assert (repeated > 55) == (not moves)  # they are not counted while the probe is held
    rig.frozen, rig.velocity = None, np.zeros(N)
    assert rig.run(0.4).state is GuardState.MONITORING


def test_the_workspace_is_left_by_nobody_and_the_way_back_is_free(rig):
    # Joint 1 turns the probe aside at 0.1 m/s.
    rig.velocity = np.r_[0.2, np.zeros(N - 1)]
    status = rig.run(6.0)
    assert "leave the configured workspace" in status.reason
    assert status.state is GuardState.HOLDING
    X = pose(rig.q)
    beyond = np.abs(X.translation() - pose(HOME).translation())[:2].max()
    assert 0.25 <= beyond < 0.253
    rig.velocity = np.r_[-0.2, np.zeros(N - 1)]
    assert rig.run(1.0).state is GuardState.MONITORING
