"""The arm with its probe, in any plant."""

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointIndex, ModelInstanceIndex, RigidBody

from sonoservo.models import model_path


@dataclass(frozen=True)
class ArmWithProbe:
    """Where the arm and its probe are in a plant.

    Parameters
    ----------
    model_instance
        The arm's six joints.
    probe
        The probe's body, whose frame is P.
    wrist
        The weld of the probe to the flange: its reaction is what a wrist force sensor feels.
    """

    model_instance: ModelInstanceIndex
    probe: RigidBody
    wrist: JointIndex


def AddArmWithProbe(plant: MultibodyPlant) -> ArmWithProbe:
    """Add the arm, with its base at the origin of W, and the probe in line with its flange."""
    parser = Parser(plant)
    (arm,) = parser.AddModels(str(model_path("viper_s850.urdf")))
    (probe,) = parser.AddModels(str(model_path("probe_4dc7.sdf")))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link", arm))
    # The probe looks along the flange's axis: Y_P = Z_F, X_P = X_F.
    wrist = plant.WeldFrames(
        plant.GetFrameByName("flange", arm),
        plant.GetFrameByName("wrist_sensor", probe),
        RigidTransform(RotationMatrix.MakeXRotation(np.pi / 2)),
    )
    return ArmWithProbe(arm, plant.GetBodyByName("probe", probe), wrist.index())


def MakeArmPlant() -> tuple[MultibodyPlant, ArmWithProbe]:
    """Make a plant of the arm and its probe alone, for kinematics."""
    plant = MultibodyPlant(time_step=0)
    arm = AddArmWithProbe(plant)
    plant.Finalize()
    return plant, arm
