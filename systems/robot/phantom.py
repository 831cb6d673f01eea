"""The phantom on its moving stage."""

from collections.abc import Sequence
from dataclasses import dataclass

from pydrake.geometry import Box, Cylinder, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import Trajectory

from sonoservo.models import model_path

_TRAY, _POST = 0.006, 0.1
"""Height of what the phantom stands on, in m."""


@dataclass(frozen=True)
class Phantom:
    """Where the phantom is in a plant.

    Parameters
    ----------
    model_instance
        The six joints of the stage, actuated in the order x, y, z, roll, pitch, yaw.
    body
        The body whose frame is T.
    """

    model_instance: ModelInstanceIndex
    body: RigidBody


def AddPhantom(plant: MultibodyPlant, scene_graph: SceneGraph, *, size: Sequence[float]) -> Phantom:
    """Add the agar phantom, with its stage's origin at the origin of W.

    Parameters
    ----------
    plant, scene_graph
        Where to add it, before the plant is finalized.
    size
        (3,) extents of the box along X, Y, Z of T, in m.
    """
    (instance,) = Parser(plant).AddModels(str(model_path("agar_phantom.sdf")))
    phantom, column = (plant.GetBodyByName(name, instance) for name in ("phantom", "stage_z"))
    x, y, z = size
    (contact,) = plant.GetCollisionGeometriesForBody(phantom)
    box, tray = plant.GetVisualGeometriesForBody(phantom)
    (post,) = plant.GetVisualGeometriesForBody(column)
    for geometry, shape, centre in (
        (contact, Box(x, y, z), -z / 2),
        (box, Box(x, y, z), -z / 2),
        (tray, Box(x + 0.02, y + 0.02, _TRAY), -z - 0.001 - _TRAY / 2),
        (post, Cylinder(0.03, _POST), -z - _TRAY - _POST / 2),
    ):
        scene_graph.ChangeShape(
            plant.get_source_id(), geometry, shape, RigidTransform([0, 0, centre])
        )
    return Phantom(instance, phantom)


def PhantomMotion(*, trajectory: Trajectory) -> Diagram:
    """Make the source of a station's `phantom_command` from a motion.

    .. pydrake_system::

        name: phantom_motion
        output_ports:
        - phantom_command

    Parameters
    ----------
    trajectory
        Of x, y, z in m, roll, pitch, yaw in rad: the pose X_WT.
    """
    builder = DiagramBuilder()
    source = builder.AddSystem(TrajectorySource(trajectory, output_derivative_order=1))
    builder.ExportOutput(source.get_output_port(), "phantom_command")
    motion = builder.Build()
    motion.set_name("phantom_motion")
    return motion
