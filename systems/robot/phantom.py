"""The phantom on its moving stage."""

from collections.abc import Sequence
from dataclasses import dataclass

from pydrake.geometry import Box, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import Trajectory

from sonoservo.models import model_path


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
    body = plant.GetBodyByName("phantom", instance)
    geometries = [
        *plant.GetCollisionGeometriesForBody(body),
        *plant.GetVisualGeometriesForBody(body),
    ]
    for geometry in geometries:
        scene_graph.ChangeShape(
            plant.get_source_id(), geometry, Box(*size), RigidTransform([0, 0, -size[2] / 2])
        )
    return Phantom(instance, body)


def PhantomMotion(*, trajectory: Trajectory) -> TrajectorySource:
    """Make the source of a station's `phantom_command` from a motion.

    Parameters
    ----------
    trajectory
        Of x, y, z in m, roll, pitch, yaw in rad: the pose X_WT.
    """
    return TrajectorySource(trajectory, output_derivative_order=1)
