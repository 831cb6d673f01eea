"""Body of the probe: its mass, its housing and the dome that touches the phantom."""

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydrake.common.schema import Transform
from pydrake.geometry import (
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Cylinder,
    Ellipsoid,
    ProximityProperties,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import ModelDirective
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    MultibodyPlant,
)
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    ModelInstanceIndex,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import DiagramBuilder

from sonoservo.systems.robot.directives import add_directives
from sonoservo.systems.signals.requirements import Bound, Bounded, Positive

_FLAT = 1.0  # Radius of curvature in m from which a face counts as flat
_MARGIN = 5e-3  # Assumed width and depth in m of the housing's rim around a flat array
_DOME_COLOUR, _HOUSING_COLOUR = (0.20, 0.22, 0.25, 1.0), (0.85, 0.87, 0.88, 1.0)


@dataclass(kw_only=True)
class AssumedBody(Bounded):
    """Body of a probe with an unknown housing: a dome on a cylinder.

    Parameters
    ----------
    dome
        (3,) semi-axes of the dome along X, Y, Z of P, in m. If empty, they follow from the
        transducer (see `dome_semi_axes`).
    mass
        Mass in kg, spread evenly along the probe's length.
    length
        Distance from the centre of the face to the wrist force sensor, in m.
    """

    dome: Annotated[
        list[Positive], Bound("three lengths in m, or empty", lambda value: len(value) in (0, 3))
    ] = field(default_factory=list)
    mass: Positive = 0.5
    length: Positive = 0.2


def _in_line_with_the_flange() -> Transform:
    return Transform(RigidTransform(RotationMatrix.MakeXRotation(np.pi / 2)))


@dataclass(kw_only=True)
class ProbeBody:
    """Body of a probe, and its mount on the arm.

    Parameters
    ----------
    directives
        Drake model directives that add a model named ``probe``. Its link ``probe`` has frame P. The
        flange holds it at its frame ``wrist_sensor``, whose axes are parallel to those of P. If
        empty, the assumed body is used.
    assumed
        Body of a probe without directives.
    mount
        Pose of ``wrist_sensor`` in the arm's flange frame. By default the probe looks along the
        flange's Z axis, and X_P is the flange's X axis.
    """

    directives: list[ModelDirective] = field(default_factory=list)
    assumed: AssumedBody = field(default_factory=AssumedBody)
    mount: Transform = field(default_factory=_in_line_with_the_flange)


def dome_semi_axes(
    *, array_radius: float, motor_radius: float, width: float, height: float
) -> list[float]:
    """Return the (3,) semi-axes in m of an ellipsoid with the curvature of a transducer's face.

    Its radii of curvature at the apex on Y are those of array and motor, a^2 / b and c^2 / b. Along
    a flat side (a radius of 0 or above 1 m) it is assumed to extend 5 mm beyond the elements.
    """
    array_radius, motor_radius = (r if r < _FLAT else 0.0 for r in (array_radius, motor_radius))
    b = motor_radius or array_radius or _MARGIN
    a = math.sqrt(array_radius * b) or width / 2 + _MARGIN
    c = math.sqrt(motor_radius * b) or height / 2 + _MARGIN
    return [a, b, c]


def AddProbeBody(plant: MultibodyPlant, body: ProbeBody) -> ModelInstanceIndex:
    """Add a probe's body to a plant, and return its model instance.

    ValueError if its directives produce none.
    """
    if not body.directives:
        return _add_assumed_body(plant, body.assumed)
    add_directives(plant, body.directives)
    if not plant.HasModelInstanceNamed("probe"):
        raise ValueError("directives: no add_model adds a model named 'probe'")
    instance = plant.GetModelInstanceByName("probe")
    for has, kind, name in (
        (plant.HasBodyNamed, "link", "probe"),
        (plant.HasFrameNamed, "frame", "wrist_sensor"),
    ):
        if not has(name, instance):
            raise ValueError(f"directives: the model 'probe' has no {kind} named {name!r}")
    return instance


def distance_to_probe(body: ProbeBody, points: NDArray[np.float64]) -> float:
    """Return the least distance in m of (m, 3) points in P from a probe's body, below 0 inside."""
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    AddProbeBody(plant, body)
    plant.Finalize()
    context = builder.Build().CreateDefaultContext()
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(context))
    near = [each for point in points for each in query.ComputeSignedDistanceToPoint(point)]
    return min((each.distance for each in near), default=np.inf)


def _add_assumed_body(plant: MultibodyPlant, body: AssumedBody) -> ModelInstanceIndex:
    instance = plant.AddModelInstance("probe")
    length = body.length
    a, b, c = body.dome or 3 * [_MARGIN]
    radius = min(a, c, 0.025)
    middle = np.array([0.0, -length / 2, 0.0])
    inertia = UnitInertia.SolidCylinder(radius, length, np.array([0.0, 1.0, 0.0]))
    link = plant.AddRigidBody(
        "probe",
        instance,
        SpatialInertia(body.mass, middle, inertia.ShiftFromCenterOfMass(middle)),
    )
    plant.AddFrame(
        FixedOffsetFrame("wrist_sensor", link.body_frame(), RigidTransform([0.0, -length, 0.0]))
    )
    if not plant.geometry_source_is_registered():
        return instance
    contact = ProximityProperties()
    AddRigidHydroelasticProperties(0.6 * max(a, b, c), contact)
    # The phantom's contact sets the friction of the two.
    AddContactMaterial(friction=CoulombFriction(0.0, 0.0), properties=contact)
    dome, apex = Ellipsoid(a, b, c), RigidTransform([0.0, -b, 0.0])
    plant.RegisterCollisionGeometry(link, apex, dome, "dome", contact)
    plant.RegisterVisualGeometry(link, apex, dome, "dome", _DOME_COLOUR)
    along_y = RotationMatrix.MakeXRotation(np.pi / 2)
    plant.RegisterVisualGeometry(
        link,
        RigidTransform(along_y, [0.0, -(length + b) / 2, 0.0]),
        Cylinder(radius, max(length - b, _MARGIN)),
        "housing",
        _HOUSING_COLOUR,
    )
    return instance
