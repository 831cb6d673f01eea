"""Errors of an arm's calibration: place and mass of the probe, and zero positions of the joints."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.signals.requirements import Bounded, NotNegative, above, within


@dataclass(kw_only=True)
class CalibrationParameters(Bounded):
    """Errors of the calibration; their directions are drawn once for each run.

    Parameters
    ----------
    hand_eye_translation
        Distance between the probe's calibrated and its true position on the flange, in m.
    hand_eye_rotation_deg
        Angle between the probe's calibrated and its true orientation on the flange, in deg.
    joint_offset_deg
        Standard deviation of the errors of the joints' zero positions, in deg.
    probe_mass
        Relative error of the probe's mass in the gravity compensation; 0.05 is 5 % too heavy.
    """

    hand_eye_translation: Annotated[float, within(0, 0.1, " m")] = 0.0
    hand_eye_rotation_deg: Annotated[float, within(0, 45, " deg")] = 0.0
    joint_offset_deg: NotNegative = 0.0
    probe_mass: Annotated[float, above(-1)] = 0.0

    @property
    def moves_probe(self) -> bool:
        """True if the pose of the probe is not known exactly."""
        errors = (self.hand_eye_translation, self.hand_eye_rotation_deg, self.joint_offset_deg)
        return any(errors)


def hand_eye_error(parameters: CalibrationParameters, seed: int) -> RigidTransform:
    """Return the pose X_PC of the calibrated probe frame in the true one, drawn by a seed."""
    rng = np.random.default_rng([seed, 1])
    along, axis = (each / np.linalg.norm(each) for each in rng.normal(size=(2, 3)))
    turn = AngleAxis(np.deg2rad(parameters.hand_eye_rotation_deg), axis)
    return RigidTransform(RotationMatrix(turn), parameters.hand_eye_translation * along)


def joint_offsets(parameters: CalibrationParameters, joints: int, seed: int) -> NDArray[np.float64]:
    """Return the (joints,) amounts in rad by which the joints' readings exceed their positions."""
    rng = np.random.default_rng([seed, 2])
    return np.deg2rad(parameters.joint_offset_deg) * rng.normal(size=joints)
