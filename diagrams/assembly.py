"""Arm, probe and phantom by name: the models behind a station and a controller."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant

from sonoservo.systems.files.model_file import model_file, read_once, read_section
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import load_typed
from sonoservo.systems.robot.arm import ArmWithProbe, MakeArmPlant, load_arm
from sonoservo.systems.robot.directives import resolve_files
from sonoservo.systems.robot.probe_body import AddProbeBody, ProbeBody, dome_semi_axes
from sonoservo.systems.ultrasound.transducer import load_transducer

ARM, PROBE, PHANTOM = "viper_s850", "4dc7_3_40", "agar"
"""Names of the default models."""


def load_probe_body(name: str) -> ProbeBody:
    """Read the body of a probe from YAML and check it.

    A body without directives and without a dome gets the dome that fits the probe's transducer.
    """
    return _read_probe_body(model_file("probes", name))


@read_once
def _read_probe_body(path: Path) -> ProbeBody:
    content = read_section(path, "body", ("transducer", "body"))
    body = load_typed(ProbeBody, content, f"{path}: body")
    resolve_files(body.directives, path)
    transducer = load_transducer(str(path))
    if not body.assumed.dome:
        dome = dome_semi_axes(
            array_radius=transducer.array_radius,
            motor_radius=transducer.motor_radius,
            width=transducer.elements * transducer.element_pitch,
            height=transducer.element_height,
        )
        body = replace(body, assumed=replace(body.assumed, dome=dome))
    try:
        AddProbeBody(MultibodyPlant(time_step=0), body)
    except ValueError as error:
        raise ConfigurationError(f"{path}: body.{error}") from error
    return body


def load_dome_radius(name: str) -> float:
    """Return the radius in m of a sphere with the mean curvature of a probe's dome at its apex."""
    a, b, c = load_probe_body(name).assumed.dome
    return a * c / b


def assemble_arm(
    arm: str = ARM, probe: str = PROBE, X_PC: RigidTransform | None = None
) -> ArmWithProbe:
    """Return a plant of an arm and its probe alone, for kinematics; it is shared, do not change it.

    Parameters
    ----------
    arm, probe
        Names of files in ``models/robots`` and ``models/probes``, or paths.
    X_PC
        Pose of the calibrated probe frame in the true one; by default they are the same.
    """
    pose = (X_PC or RigidTransform()).GetAsMatrix4().tobytes()
    return _assembled(_Same(load_arm(arm)), _Same(load_probe_body(probe)), pose)


@dataclass(frozen=True, eq=False)
class _Same:
    """A model as a key: files that have not changed give the same object again."""

    model: Any

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.model is other.model

    def __hash__(self) -> int:
        return id(self.model)


@lru_cache(maxsize=8)
def _assembled(arm: _Same, body: _Same, X_PC: bytes) -> ArmWithProbe:
    pose = RigidTransform(np.frombuffer(X_PC).reshape(4, 4))
    return MakeArmPlant(arm.model, body.model, pose)
