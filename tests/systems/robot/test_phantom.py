import numpy as np
import pytest
from pydrake.geometry import Box, Role, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.trajectories import PiecewisePolynomial

from sonoservo.systems.robot import AddPhantom, AddProbeBody
from sonoservo.systems.robot.contact_force import normal_force
from sonoservo.systems.robot.phantom import (
    PhantomContact,
    PhantomMotion,
    load_contact,
    set_friction,
)
from sonoservo.systems.robot.posture import probe_pose
from sonoservo.systems.robot.probe_body import AssumedBody, ProbeBody
from sonoservo.systems.signals import BodySurface

SIZE = [0.3, 0.2, 0.05]


def test_phantom_has_the_size_asked_for_below_frame_t():
    plant, scene_graph = MultibodyPlant(time_step=0.001), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    phantom = AddPhantom(plant, scene_graph, surface=BodySurface(SIZE), contact=PhantomContact())
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    frame = plant.GetBodyFrameIdOrThrow(phantom.body.index())
    boxes = []
    for role in (Role.kProximity, Role.kIllustration):
        for geometry in inspector.GetGeometries(frame, role):
            shape = inspector.GetShape(geometry)
            centre = inspector.GetPoseInFrame(geometry).translation()
            boxes.append((shape, centre[2] + shape.height() / 2))
    assert [(shape.size().tolist(), round(top, 9)) for shape, top in boxes[:2]] == [(SIZE, 0)] * 2
    (tray, top) = boxes[2]
    assert isinstance(tray, Box)
    assert top < -SIZE[2]


def test_contact_loads_from_the_phantoms_file(tmp_path):
    assert load_contact("agar") == load_contact("beef") == PhantomContact()
    path = tmp_path / "mine.yaml"
    path.write_text("contact: {hydroelastic_modulus: 3.0e4}\n")
    assert load_contact(str(path)).hydroelastic_modulus == 3e4
    path.write_text("contact: {hydroelastic_modulus: -1}\n")
    with pytest.raises(ValueError, match=r"mine\.yaml: contact: hydroelastic_modulus: -1"):
        load_contact(str(path))


BOX = BodySurface([0.24, 0.16, 0.08])
LIMB = BodySurface([0.3, 0.12, 0.12], "cylinder")
ABDOMEN = BodySurface([0.32, 0.24, 0.12], "ellipsoid")


def slide(surface, *, friction=0.0, velocity=(0, 0, 0), y=0.0):
    """The force on the phantom, the normal part of it, and the normal, with the dome pressed in."""
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(time_step=0.001, contact_model="hydroelastic_with_fallback")
    plant, scene_graph = AddMultibodyPlant(config, builder)
    contact = PhantomContact(friction=friction, hunt_crossley_dissipation=0.0)
    phantom = AddPhantom(plant, scene_graph, surface=surface, contact=contact)
    # So heavy that it neither slows down nor falls in the 2 ms of the simulation.
    assumed = AssumedBody(dome=[0.033, 0.02725, 0.02725], mass=1e4)
    probe = plant.GetBodyByName("probe", AddProbeBody(plant, ProbeBody(assumed=assumed)))
    set_friction(plant, scene_graph, probe, friction)
    plant.mutable_gravity_field().set_gravity_vector([0, 0, 0])
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    for index in plant.GetJointIndices(phantom.model_instance):
        plant.get_joint(index).Lock(context)
    X_WT = RigidTransform()
    pose = probe_pose(X_WT=X_WT, x=0.0, y=y, yaw=0.0, height=-3e-3, surface=surface)
    plant.SetFreeBodyPose(context, probe, pose)
    plant.SetFreeBodySpatialVelocity(context, probe, SpatialVelocity([0, 0, 0], velocity))
    simulator.AdvanceTo(0.002)
    results = plant.get_contact_results_output_port().Eval(context)
    info = results.hydroelastic_contact_info(0)
    force = info.F_Ac_W().translational()
    normal = surface.normal(info.contact_surface().centroid())
    return force * -np.sign(force @ normal), normal_force(results, X_WT, surface), normal


@pytest.mark.parametrize(("surface", "friction"), [(BOX, 0.3), (LIMB, 0.02)])
def test_a_sliding_probe_drags_by_coulomb_s_share_of_its_force(surface, friction):
    """The contact is a bowl, not a plane, whose slopes add up to 4 % more to the friction."""
    (to, pressed, _), (fro, _, _) = (
        slide(surface, friction=friction, velocity=(speed, 0.0, 0.0)) for speed in (5e-3, -5e-3)
    )
    assert pressed > 0.3
    assert abs(to[0] - fro[0]) / 2 == pytest.approx(friction * pressed, rel=0.04)


@pytest.mark.parametrize("surface", [LIMB, ABDOMEN], ids=lambda each: each.shape)
def test_without_friction_a_curved_body_pushes_along_its_normal(surface):
    """20 mm beside the apex; the facets of the body's mesh let it deviate by a degree."""
    force, pressed, normal = slide(surface, y=0.02)
    foot = np.array([0.0, 0.02, surface.height(0.0, 0.02)])
    assert normal @ surface.normal(foot) > np.cos(np.deg2rad(2))
    angle = np.arccos(abs(force @ normal) / np.linalg.norm(force))
    assert np.rad2deg(angle) < 1.0
    assert pressed == pytest.approx(np.linalg.norm(force), rel=1e-3)


def test_motion_gives_position_and_velocity():
    trajectory = PiecewisePolynomial.FirstOrderHold(
        [0, 2], np.array([np.zeros(6), np.arange(6.0)]).T
    )
    source = PhantomMotion(trajectory=trajectory)
    context = source.CreateDefaultContext()
    context.SetTime(0.5)
    command = source.get_output_port().Eval(context)
    np.testing.assert_allclose(command, np.concatenate([np.arange(6) / 4, np.arange(6) / 2]))
