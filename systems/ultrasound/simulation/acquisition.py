"""Simulated acquisition of a sweep: its samples, and the time and pose of each frame."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import seal
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.sweep import Sweep, SweepMotion
from sonoservo.systems.ultrasound.simulation.errors.connection import repeat_lost_frames
from sonoservo.systems.ultrasound.simulation.errors.motor import (
    MotorParameters,
    motor_error,
    turned,
)
from sonoservo.systems.ultrasound.simulation.reaction.deformation import Deformation
from sonoservo.systems.ultrasound.simulation.rendering import SweepRenderer


def acquire_sweep(
    renderer: SweepRenderer,
    motion: SweepMotion,
    needles: Sequence[Needle],
    *,
    X_TP: NDArray[np.float64] | None = None,
    number: int = 0,
    deformations: Sequence[Deformation] | None = None,
) -> Sweep:
    """Acquire a sweep of the simulated scanner, at rest or along a motion.

    Errors of the motor and lost frames are in the samples; the motion does not know of them.

    Parameters
    ----------
    renderer
        Renderer of the probe over the tissue.
    motion
        Time and pose of each frame: `SweepMotion.at_rest`, or any other motion.
    needles
        (frames,) needles in T at each frame's time, possibly empty.
    X_TP
        (frames, 4, 4) poses of the probe in the tissue at each frame's time; by default, the
        tissue's frame T is the world frame.
    number
        Number of the sweep, which selects the noise and the errors.
    deformations
        (frames,) deformations of the tissue at each frame's time; None for undeformed tissue.
    """
    poses = motion.X_WP if X_TP is None else X_TP
    motor, lost = renderer.parameters.motor, renderer.parameters.connection.lost_frames
    direction, rng = motion.direction, np.random.default_rng([renderer.seed, 4, number])
    if motor != MotorParameters():
        angles = motor_error(motor, len(poses), direction, rng)
        poses = turned(poses, angles, motion.geometry)
    samples = renderer.render(poses, needles, direction, number, motion.times, deformations)
    if lost:
        samples = repeat_lost_frames(samples, lost, direction, rng)
    return Sweep(seal(samples), motion, renderer.decibels_per_level, renderer.point_spread)
