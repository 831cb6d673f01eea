"""Phantom on its moving stage, in any plant."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    Box,
    Cylinder,
    Ellipsoid,
    ProximityProperties,
    RoleAssign,
    SceneGraph,
    Shape,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, PdControllerGains, RigidBody
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import Trajectory

from sonoservo.models import model_path
from sonoservo.systems.files.model_file import model_file, read_once, read_section
from sonoservo.systems.files.typed_yaml import load_typed
from sonoservo.systems.robot.directives import motors
from sonoservo.systems.signals.body_surface import BodySurface
from sonoservo.systems.signals.requirements import (
    Bounded,
    NotNegative,
    Positive,
)

_TRAY, _POST = 0.006, 0.1  # Heights of the tray and the post on which the phantom stands, in m
# Edge in m of the triangles of a curved body; the surface of 60 mm radius is true to 0.2 mm.
_RESOLUTION = 0.01


# Drake treats these gains implicitly, so stiffness costs no stability. The stage is ideal, because
# its motion is the ground truth.
_STAGE_GAINS = PdControllerGains(p=1e7, d=1e5)


@dataclass(kw_only=True)
class PhantomContact(Bounded):
    """Contact properties of the phantom's surface, calibrated together with the probe's dome.

    Parameters
    ----------
    hydroelastic_modulus
        Pressure at the body's middle in Pa, which differs from Young's modulus: the pressure rises
        from 0 at the surface, so twice as thick a body needs twice the modulus to be as stiff.
    hunt_crossley_dissipation
        Dissipation in s/m.
    point_contact_stiffness
        Stiffness in N/m for the contact model "point".
    friction
        Coefficient of friction between the surface and a probe's face: 0.02 with gel; 0.3 to 0.6
        on dry skin (Zhang and Mak 1999).
    """

    hydroelastic_modulus: Positive = 67e3
    hunt_crossley_dissipation: NotNegative = 1.0
    point_contact_stiffness: Positive = 600.0
    friction: NotNegative = 0.02


def load_contact(name: str) -> PhantomContact:
    """Read the contact of a phantom's surface from its YAML file, by name or path."""
    return _read_contact(model_file("phantoms", name))


@read_once
def _read_contact(path: Path) -> PhantomContact:
    content = read_section(path, "contact", ("tissue", "contact"))
    return load_typed(PhantomContact, content, f"{path}: contact")


@dataclass(frozen=True)
class Phantom:
    """Phantom in a plant: its model instance, and the body whose frame is T."""

    model_instance: ModelInstanceIndex
    body: RigidBody


def AddPhantom(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    *,
    surface: BodySurface,
    contact: PhantomContact | None = None,
) -> Phantom:
    """Add a phantom on its stage to a plant, with the stage's origin at the origin of W.

    The contact is by default that of agar.
    """
    contact = contact or PhantomContact()
    (instance,) = Parser(plant).AddModels(str(model_path("phantoms/phantom.sdf")))
    phantom, column = (plant.GetBodyByName(name, instance) for name in ("phantom", "stage_z"))
    x, y, z = surface.size
    properties = ProximityProperties()
    # The resolution hint is not used for a box, whose mesh follows from its medial axis.
    hint = _RESOLUTION if surface.is_curved else 1.0
    AddCompliantHydroelasticProperties(hint, contact.hydroelastic_modulus, properties)
    AddContactMaterial(
        dissipation=contact.hunt_crossley_dissipation,
        point_stiffness=contact.point_contact_stiffness,
        friction=CoulombFriction(contact.friction, contact.friction),
        properties=properties,
    )
    body, X_TBody = _shape(surface)
    plant.RegisterCollisionGeometry(phantom, X_TBody, body, "box", properties)
    box, tray = plant.GetVisualGeometriesForBody(phantom)
    (post,) = plant.GetVisualGeometriesForBody(column)
    for geometry, shape, pose in (
        (box, body, X_TBody),
        (tray, Box(x + 0.02, y + 0.02, _TRAY), RigidTransform([0, 0, -z - 0.001 - _TRAY / 2])),
        (post, Cylinder(0.03, _POST), RigidTransform([0, 0, -z - _TRAY - _POST / 2])),
    ):
        scene_graph.ChangeShape(plant.get_source_id(), geometry, shape, pose)
    for motor in motors(plant, instance):
        motor.set_controller_gains(_STAGE_GAINS)
    return Phantom(instance, phantom)


def set_friction(
    plant: MultibodyPlant, scene_graph: SceneGraph, probe: RigidBody, friction: float
) -> None:
    """Set the friction of a probe's face to that of the phantom it is to touch."""
    # Drake combines two coefficients to 2 a b / (a + b), so equal ones hold for the pair.
    for geometry in plant.GetCollisionGeometriesForBody(probe):
        found = scene_graph.model_inspector().GetProximityProperties(geometry)
        properties = ProximityProperties(found)
        properties.UpdateProperty(
            "material", "coulomb_friction", CoulombFriction(friction, friction)
        )
        scene_graph.AssignRole(plant.get_source_id(), geometry, properties, RoleAssign.kReplace)


def _shape(surface: BodySurface) -> tuple[Shape, RigidTransform]:
    """Return a body's shape and its pose in T."""
    x, y, z = surface.size
    centre = [0, 0, -z / 2]
    if surface.shape == "cylinder":
        along_x = RotationMatrix.MakeYRotation(np.pi / 2)
        return Cylinder(z / 2, x), RigidTransform(along_x, centre)
    if surface.shape == "ellipsoid":
        return Ellipsoid(x / 2, y / 2, z / 2), RigidTransform(centre)
    return Box(x, y, z), RigidTransform(centre)


def PhantomMotion(*, trajectory: Trajectory) -> Diagram:
    """Return a system that outputs a station's `phantom_command` from a trajectory of X_WT."""
    builder = DiagramBuilder()
    source = builder.AddSystem(TrajectorySource(trajectory, output_derivative_order=1))
    builder.ExportOutput(source.get_output_port(), "phantom_command")
    motion = builder.Build()
    motion.set_name("phantom_motion")
    return motion
