import numpy as np
import pytest
from pydrake.geometry import Ellipsoid, SceneGraph
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator

from sonoservo.diagrams.station import MakeStation, StationParameters, start_posture
from sonoservo.models import model_path
from sonoservo.systems.robot.probe_body import dome_semi_axes
from sonoservo.systems.ultrasound.transducer import load_transducer

FOLDER = model_path("package.xml").parent
ROBOTS, PROBES, PHANTOMS = (
    sorted(path.stem for path in (FOLDER / folder).glob("*.yaml"))
    for folder in ("robots", "probes", "phantoms")
)

# Standard DH: a (m), d (m), alpha, offset of theta.
DH = {
    "viper_s850": (
        (0.075, 0.335, -np.pi / 2, 0),
        (0.365, 0, 0, 0),
        (0.090, 0, -np.pi / 2, -np.pi),
        (0, 0.405, np.pi / 2, 0),
        (0, 0, -np.pi / 2, 0),
        (0, 0.080, 0, -np.pi),
    ),
    "ur5e": (
        (0, 0.1625, np.pi / 2, 0),
        (-0.425, 0, 0, 0),
        (-0.3922, 0, 0, 0),
        (0, 0.1333, np.pi / 2, 0),
        (0, 0.0997, -np.pi / 2, 0),
        (0, 0.0996, 0, 0),
    ),
    "lbr_iiwa_14": (
        (0, 0.360, -np.pi / 2, 0),
        (0, 0, np.pi / 2, 0),
        (0, 0.420, np.pi / 2, 0),
        (0, 0, -np.pi / 2, 0),
        (0, 0.400, -np.pi / 2, 0),
        (0, 0, np.pi / 2, 0),
        (0, 0.126, 0, 0),
    ),
}
LIMITS_DEG = {
    "ur5e": 6 * ((-360, 360),),
    "viper_s850": ((-170, 170), (-190, 45), (-29, 256), (-190, 190), (-120, 120), (-360, 360)),
    "lbr_iiwa_14": tuple((-limit, limit) for limit in (170, 120, 170, 120, 170, 120, 175)),
}


def dh_transform(a, d, alpha, theta):
    """Rz(theta) Tz(d) Tx(a) Rx(alpha), written out."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
    )


@pytest.fixture(scope="module", params=sorted(DH))
def arm(request):
    plant = MultibodyPlant(time_step=0)
    Parser(plant).AddModels(str(model_path(f"robots/{request.param}.urdf")))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    plant.Finalize()
    return plant


def arm_name(plant):
    return next(name for name in DH if plant.HasModelInstanceNamed(name))


@pytest.mark.parametrize(
    ("arm", "probe", "phantom"),
    [
        *((name, "4dc7_3_40", "agar") for name in ROBOTS),
        *(("viper_s850", name, "agar") for name in PROBES),
        *(("viper_s850", "4dc7_3_40", name) for name in PHANTOMS),
    ],
)
def test_every_yaml_makes_a_station_that_steps(arm, probe, phantom):
    parameters = StationParameters(arm=arm)
    station = MakeStation(parameters=parameters, probe=probe, phantom=phantom)
    simulator = Simulator(station)
    context = simulator.get_mutable_context()
    q = start_posture(parameters, probe)
    command = np.concatenate([q, np.zeros_like(q)])
    station.GetInputPort("joint_command").FixValue(context, command)
    rest = [*parameters.phantom_position, *np.zeros(9)]
    station.GetInputPort("phantom_command").FixValue(context, rest)
    simulator.AdvanceTo(0.05)
    state = station.GetOutputPort("joint_state").Eval(context)
    np.testing.assert_allclose(state, command, atol=1e-2)


def test_flange_agrees_with_the_dh_table(arm):
    table = DH[arm_name(arm)]
    context = arm.CreateDefaultContext()
    flange = arm.GetFrameByName("flange")
    rng = np.random.default_rng(1)
    for q in rng.uniform(-np.pi, np.pi, (200, len(table))):
        arm.SetPositions(context, q)
        expected = np.linalg.multi_dot(
            [dh_transform(a, d, alpha, t + x) for (a, d, alpha, t), x in zip(table, q, strict=True)]
        )
        got = flange.CalcPoseInWorld(context).GetAsMatrix4()
        np.testing.assert_allclose(got, expected, atol=1e-12)


def test_joint_limits_are_the_makers(arm):
    lower, upper = np.deg2rad(LIMITS_DEG[arm_name(arm)]).T
    np.testing.assert_allclose(arm.GetPositionLowerLimits(), lower, atol=1e-12)
    np.testing.assert_allclose(arm.GetPositionUpperLimits(), upper, atol=1e-12)
    assert np.isfinite(arm.GetVelocityUpperLimits()).all()


def test_every_part_of_the_arm_has_a_physical_inertia(arm):
    for index in arm.GetBodyIndices(arm.GetModelInstanceByName(arm_name(arm))):
        body = arm.get_body(index)
        assert body.default_spatial_inertia().IsPhysicallyValid(), body.name()


def test_dome_has_the_radii_of_the_transducer():
    plant, scene_graph = MultibodyPlant(time_step=0.001), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    Parser(plant).AddModels(str(model_path("probes/4dc7_3_40.sdf")))
    plant.Finalize()
    (geometry,) = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("probe"))
    inspector = scene_graph.model_inspector()
    dome = inspector.GetShape(geometry)
    assert isinstance(dome, Ellipsoid)
    # The apex is the origin of P, and there an ellipsoid's radii of curvature are a^2 / b.
    apex = inspector.GetPoseInFrame(geometry).multiply([0, dome.b(), 0])
    np.testing.assert_allclose(apex, 0, atol=1e-12)
    assert dome.a() ** 2 / dome.b() == pytest.approx(0.040, rel=2e-3)
    assert dome.c() ** 2 / dome.b() == pytest.approx(0.02725)
    transducer = load_transducer("4dc7_3_40")
    semi_axes = dome_semi_axes(
        array_radius=transducer.array_radius,
        motor_radius=transducer.motor_radius,
        width=0.0,
        height=0.0,
    )
    np.testing.assert_allclose([dome.a(), dome.b(), dome.c()], semi_axes, atol=2e-5)
