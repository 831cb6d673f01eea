import numpy as np
import pytest
from pydrake.geometry import Ellipsoid, SceneGraph
from pydrake.multibody.plant import MultibodyPlant

from sonoservo.systems.robot import AddProbeBody
from sonoservo.systems.robot.probe_body import AssumedBody, ProbeBody, dome_semi_axes


def test_the_dome_is_curved_like_the_face():
    a, b, c = dome_semi_axes(array_radius=0.06, motor_radius=0.04, width=0.05, height=0.01)
    assert (a**2 / b, c**2 / b) == pytest.approx((0.06, 0.04))


@pytest.mark.parametrize(
    ("array_radius", "motor_radius", "expected"),
    [
        (0.0, 0.0, [0.025, 0.005, 0.010]),  # flat: a rim of 5 mm
        (0.06, 0.0, [0.06, 0.06, 0.010]),  # convex, without a motor
        (5.0, 0.04, [0.025, 0.04, 0.04]),  # linear, as an arc of a large radius
    ],
)
def test_a_flat_side_ends_beyond_the_elements(array_radius, motor_radius, expected):
    semi_axes = dome_semi_axes(
        array_radius=array_radius, motor_radius=motor_radius, width=0.04, height=0.01
    )
    assert semi_axes == pytest.approx(expected)


def test_an_assumed_body_has_its_dome_mass_and_wrist():
    plant, scene_graph = MultibodyPlant(time_step=0.001), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    body = ProbeBody(assumed=AssumedBody(dome=[0.02, 0.01, 0.015], mass=0.3, length=0.12))
    instance = AddProbeBody(plant, body)
    plant.Finalize()
    link = plant.GetBodyByName("probe", instance)
    assert link.default_mass() == 0.3
    assert link.default_spatial_inertia().IsPhysicallyValid()
    np.testing.assert_allclose(link.default_com(), [0, -0.06, 0])
    wrist = plant.GetFrameByName("wrist_sensor", instance)
    np.testing.assert_allclose(wrist.GetFixedPoseInBodyFrame().translation(), [0, -0.12, 0])
    (geometry,) = plant.GetCollisionGeometriesForBody(link)
    inspector = scene_graph.model_inspector()
    dome = inspector.GetShape(geometry)
    assert isinstance(dome, Ellipsoid)
    assert [dome.a(), dome.b(), dome.c()] == [0.02, 0.01, 0.015]
    # The apex is the origin of P.
    apex = inspector.GetPoseInFrame(geometry).multiply([0, dome.b(), 0])
    np.testing.assert_allclose(apex, 0, atol=1e-15)
