import numpy as np
import pytest
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from sonoservo.systems.robot import ContactForce

MASS, LEAN = 0.3, 0.2


@pytest.mark.parametrize("hydroelastic", [False, True])
def test_a_block_at_rest_presses_with_its_weight(hydroelastic):
    """On ground that leans, friction bears the rest: the normal force is m g cos(lean)."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.001)
    X_WT = RigidTransform(RollPitchYaw(LEAN, 0, 0), [0, 0, 0])
    ground, feet = ProximityProperties(), ProximityProperties()
    for properties in (ground, feet):
        AddContactMaterial(friction=CoulombFriction(0.9, 0.9), properties=properties)
    if hydroelastic:
        AddCompliantHydroelasticProperties(0.1, 1e6, ground)
        AddRigidHydroelasticProperties(0.005, feet)
    plant.RegisterCollisionGeometry(
        plant.world_body(), X_WT @ RigidTransform([0, 0, -0.05]), Box(1, 1, 0.1), "ground", ground
    )
    block = plant.AddRigidBody("block", SpatialInertia.SolidBoxWithMass(MASS, 0.02, 0.02, 0.02))
    for i, (x, y) in enumerate([(-0.02, -0.02), (-0.02, 0.02), (0.02, -0.02), (0.02, 0.02)]):
        plant.RegisterCollisionGeometry(
            block, RigidTransform([x, y, 0]), Sphere(0.01), f"foot{i}", feet
        )
    plant.Finalize()
    plant.SetDefaultFloatingBaseBodyPose(block, X_WT @ RigidTransform([0, 0, 0.0101]))

    leaf = builder.AddSystem(ContactForce())
    builder.Connect(plant.get_contact_results_output_port(), leaf.GetInputPort("contact_results"))
    simulator = Simulator(builder.Build())
    context = leaf.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    leaf.GetInputPort("X_WT").FixValue(context, X_WT)
    simulator.AdvanceTo(0.5)
    force = leaf.get_output_port().Eval(context)[0]
    assert force == pytest.approx(MASS * 9.81 * np.cos(LEAN), rel=0.01)
