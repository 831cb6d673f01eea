"""Friction and normal force of a dome that slides over level and curved phantoms."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from sonoservo.systems.robot.contact_force import normal_force
from sonoservo.systems.robot.phantom import AddPhantom, PhantomContact, set_friction
from sonoservo.systems.robot.posture import probe_pose
from sonoservo.systems.robot.probe_body import AddProbeBody, AssumedBody, ProbeBody
from sonoservo.systems.signals.body_surface import BodySurface

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


@pytest.mark.parametrize(("surface", "friction"), [(BOX, 0.3), (LIMB, 0.02), (ABDOMEN, 0.3)])
def test_a_sliding_probe_drags_by_coulomb_s_share_of_its_force(surface, friction):
    """The contact is a bowl, not a plane, whose slopes add up to 4 % more to the friction."""
    (to, pressed, _), (fro, _, _) = (
        slide(surface, friction=friction, velocity=(speed, 0.0, 0.0)) for speed in (5e-3, -5e-3)
    )
    assert pressed > 0.3
    assert abs(to[0] - fro[0]) / 2 == pytest.approx(friction * pressed, rel=0.04)


def test_a_creeping_probe_drags_by_no_more():
    force, pressed, _ = slide(BOX, friction=0.3, velocity=(1e-5, 0.0, 0.0))
    assert np.hypot(*force[:2]) <= 0.3 * pressed * 1.04


@pytest.mark.parametrize("surface", [LIMB, ABDOMEN], ids=lambda each: each.shape)
def test_without_friction_a_curved_body_pushes_along_its_normal(surface):
    """20 mm beside the apex; the facets of the body's mesh let it deviate by a degree."""
    force, pressed, normal = slide(surface, y=0.02)
    foot = np.array([0.0, 0.02, surface.height(0.0, 0.02)])
    assert normal @ surface.normal(foot) > np.cos(np.deg2rad(2))
    angle = np.arccos(abs(force @ normal) / np.linalg.norm(force))
    assert np.rad2deg(angle) < 1.0
    assert pressed == pytest.approx(np.linalg.norm(force), rel=1e-3)
