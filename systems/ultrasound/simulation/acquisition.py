"""Simulated acquisition of a sweep: its samples, and the time and pose of each frame."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import seal
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.sweep import Sweep, SweepMotion
from sonoservo.systems.ultrasound.simulation.errors import (
    MotorParameters,
    motor_error,
    repeat_lost_frames,
    turned,
)
from sonoservo.systems.ultrasound.simulation.frame_renderer import Frames
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
    lost, direction = renderer.parameters.connection.lost_frames, motion.direction
    rng = _random(renderer, number)
    poses = _acquired(renderer, poses, slice(0, len(poses)), direction, rng)
    samples = renderer.render(poses, needles, direction, number, motion.times, deformations)
    if lost:
        samples = repeat_lost_frames(samples, lost, direction, rng)
    return Sweep(seal(samples), motion, renderer.decibels_per_level, renderer.point_spread)


def begin_frames(renderer: SweepRenderer, frames: Frames, number: int) -> None:
    """Begin to render frames of a sweep that `acquire_sweep` will need."""
    rng = _random(renderer, number)
    X_TP = _acquired(renderer, frames.X_TP, frames.part, frames.direction, rng)
    renderer.begin(replace(frames, X_TP=X_TP), number)


def _random(renderer: SweepRenderer, number: int) -> np.random.Generator:
    return np.random.default_rng([renderer.seed, 4, number])


def _acquired(
    renderer: SweepRenderer,
    X_TP: NDArray[np.float64],
    part: slice,
    direction: int,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """Return the poses from which a motor without errors would acquire the same frames."""
    motor, geometry = renderer.parameters.motor, renderer.geometry
    if motor == MotorParameters():
        return X_TP
    return turned(X_TP, motor_error(motor, geometry.frames, direction, rng)[part], geometry)
