import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from pydrake.trajectories import PiecewisePolynomial

from sonoservo.diagrams import (
    MakeStation,
    ProbePlacement,
    StationParameters,
    assemble_arm,
    check_reach,
    load_scenario,
    make_experiment,
    start_posture,
)
from sonoservo.systems.control.force_controller import pressing_force
from sonoservo.systems.evaluation import read_log
from sonoservo.systems.evaluation.log import write_log
from sonoservo.systems.robot import WristSensorParameters
from sonoservo.systems.robot.phantom import PhantomMotion
from sonoservo.systems.robot.posture import solve_posture

WEIGHT = 0.5 * 9.81
QUIET = {"wrist_sensor": WristSensorParameters(force_noise=0.0, torque_noise=0.0)}


class Bench:
    """A station whose arm holds a posture while the phantom is moved."""

    def __init__(self, parameters, *, q=None, phantom=None, seed=0, meshcat=None):
        builder = DiagramBuilder()
        self.station = builder.AddSystem(
            MakeStation(parameters=parameters, seed=seed, meshcat=meshcat)
        )
        q = start_posture(parameters) if q is None else q
        arm = builder.AddSystem(ConstantVectorSource(np.concatenate([q, np.zeros(6)])))
        rest = np.concatenate([parameters.X_WT.translation(), np.zeros(3)])
        if phantom is None:
            phantom = PiecewisePolynomial.FirstOrderHold([0, 100], np.array([rest, rest]).T)
        motion = builder.AddSystem(PhantomMotion(trajectory=phantom))
        for name, source in (("joint_command", arm), ("phantom_command", motion)):
            builder.Connect(source.get_output_port(), self.station.GetInputPort(name))
        self.simulator = Simulator(builder.Build())
        self.simulator.Initialize()

    def run(self, until):
        self.simulator.AdvanceTo(until)
        return self

    def __getitem__(self, port):
        context = self.station.GetMyContextFromRoot(self.simulator.get_context())
        return self.station.GetOutputPort(port).Eval(context)


def test_the_probe_stays_at_its_place_and_hangs_at_the_wrist():
    parameters = StationParameters(probe=ProbePlacement(x=0.02, y=-0.01, yaw_deg=30), **QUIET)
    bench = Bench(parameters).run(0.5)
    X_TP = parameters.X_WT.inverse() @ bench["X_WP"]
    np.testing.assert_allclose(X_TP.translation(), [0.02, -0.01, 0.015], atol=2e-4)
    R_TP = X_TP.rotation().matrix()
    np.testing.assert_allclose(R_TP[:, 0], [np.cos(np.pi / 6), np.sin(np.pi / 6), 0], atol=1e-3)
    np.testing.assert_allclose(R_TP[:, 1], [0, 0, -1], atol=1e-3)
    wrist_force = bench["wrist_force"]
    np.testing.assert_allclose(wrist_force.translational(), [0, -WEIGHT, 0], atol=5e-3)
    np.testing.assert_allclose(wrist_force.rotational(), 0, atol=1e-3)
    assert bench["contact_force"][0] == 0
    np.testing.assert_allclose(bench["joint_state"][:6], start_posture(parameters), atol=5e-4)
    np.testing.assert_allclose(bench["joint_state"][6:], 0, atol=1e-6)


def test_phantom_follows_its_command():
    parameters = StationParameters(probe=ProbePlacement(height=0.1))
    start = np.array([0.5, 0, 0.2, 0, 0, 0])
    end = start + np.array([0.04, -0.02, 0.01, 0.1, -0.2, 0.35])
    zero = np.zeros((6, 1))
    path = PiecewisePolynomial.CubicWithContinuousSecondDerivatives(
        [0, 1], np.array([start, end]).T, zero, zero
    )
    bench = Bench(parameters, phantom=path)
    for time in (0.25, 0.5, 1.0):
        expected = path.value(time).ravel()
        X_WT = bench.run(time)["X_WT"]
        # One step of the plant late while it moves at up to 60 mm/s.
        atol = 6e-4 if time < 1 else 3e-5
        np.testing.assert_allclose(X_WT.translation(), expected[:3], atol=atol)
        R_WT = RollPitchYaw(expected[3:]).ToRotationMatrix().matrix()
        np.testing.assert_allclose(X_WT.rotation().matrix(), R_WT, atol=10 * atol)


@pytest.mark.parametrize(
    ("contact_model", "depth"), [("hydroelastic_with_fallback", 4.3e-3), ("point", 3.3e-3)]
)
def test_two_newtons_press_the_probe_as_deep_as_calibrated(contact_model, depth):
    parameters = StationParameters(
        plant=MultibodyPlantConfig(time_step=0.005, contact_model=contact_model), **QUIET
    )
    q = solve_posture(assemble_arm(), parameters.probe_pose(height=-depth))
    bench = Bench(parameters, q=q).run(1.0)
    X_WP = bench["X_WP"]
    pressed = pressing_force(bench["wrist_force"], X_WP, 0.5)
    assert pressed == pytest.approx(2.0, abs=0.25)
    # The sensor and the contact tell the same.
    assert bench["contact_force"][0] == pytest.approx(pressed, abs=5e-3)


def test_sensor_noise_is_the_seeds():
    readings = [
        Bench(StationParameters(), seed=seed).run(0.1)["wrist_force"].translational()
        for seed in (1, 1, 2)
    ]
    np.testing.assert_array_equal(readings[0], readings[1])
    assert np.abs(readings[0] - readings[2]).max() > 1e-4


def test_whole_workspace_is_within_reach():
    parameters = StationParameters()
    poses = [
        parameters.probe_pose(x=x, y=y, yaw_deg=yaw, height=-0.005)
        for x in (-0.06, 0.06)
        for y in (-0.03, 0.03)
        for yaw in (-60, 60)
    ]
    outside = parameters.probe_pose(x=0.6)
    assert check_reach(parameters, [*poses, outside]) == [True] * 8 + [False]


def plant(**settings):
    return StationParameters(plant=MultibodyPlantConfig(**{"time_step": 0.005, **settings}))


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: plant(time_step=0.0), "plant.time_step"),
        (lambda: plant(discrete_contact_approximation="x"), "plant.discrete_contact.*or sap"),
        (lambda: plant(penetration_allowance=-1.0), "plant.penetration_allowance.*above 0"),
        (lambda: StationParameters(phantom_position=[0.1, 0.1]), "phantom_position"),
        (lambda: ProbePlacement(yaw_deg=float("nan")), "yaw_deg"),
    ],
)
def test_parameters_name_what_is_wrong(make, field):
    with pytest.raises(ValueError, match=field):
        make()


def test_a_scenario_runs_with_seven_joints_and_logs_them(tmp_path):
    scenario = load_scenario(
        "chatelain2013_fig5",
        changes=["station.arm=lbr_iiwa_14", "duration=2", "station.probe.height=0.006"],
    )
    experiment = make_experiment(scenario)
    experiment.run()
    log = experiment.log()
    assert log.joint_state.shape == (len(log.time), 14)
    assert np.isfinite(log.joint_state).all()
    # The probe has landed, and the arm has moved for it.
    assert log.contact_force[-1] > 1.0
    assert np.abs(log.joint_state[-1, :7] - log.joint_state[0, :7]).max() > 0.01
    path = write_log(tmp_path / "log.npz", log)
    again = read_log(path, type(log))
    np.testing.assert_array_equal(again.joint_state, log.joint_state)
