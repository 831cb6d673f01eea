"""Geometry of a sweep for the renderer: poses of its frames, rays of its lines."""

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.beam import Beam
from sonoservo.systems.ultrasound.simulation.kernels.bright_echo import (
    ELEVATION_LOBES,
    SIDE_LOBE_WIDTH,
)
from sonoservo.systems.ultrasound.simulation.kernels.echo import FADE
from sonoservo.systems.ultrasound.simulation.kernels.projection import Rays


def projection_rays(
    geometry: SweepGeometry, beam: Beam, direction: int, lead: int, reference: int
) -> Rays:
    """Return the quantities with which the kernels project points onto the lines of a sweep.

    Geometry has lengths in the tissue; levels of bright points hold at the sample ``reference``.
    """
    steps = geometry.frames * geometry.lines - 1
    cell = beam.resolution_cell
    return Rays(
        array_radius=np.float32(geometry.array_radius),
        centre_offset=np.float32(geometry.array_radius - geometry.motor_radius),
        lines_per_radian=np.float32(1 / geometry.line_pitch),
        middle_line=np.float32((geometry.lines - 1) / 2),
        twist=np.float32(direction * geometry.frame_pitch * geometry.frames / steps),
        samples_per_metre=np.float32(1 / geometry.sample_pitch),
        turns_per_metre=np.float32(2 / beam.wavelength),
        lead=lead,
        elevation_lobes=np.float32(ELEVATION_LOBES[0] * (beam.side_lobes > 0)),
        side_lobes=np.float32(beam.side_lobes / SIDE_LOBE_WIDTH),
        elevation_precision=(0.5 / beam.elevation**2).astype(np.float32),
        curvature=beam.curvature.astype(np.float32),
        share=(cell.min() / cell / (1 + FADE)).astype(np.float32),
        line_sigma=line_widths(geometry, beam).astype(np.float32),
        bright=np.sqrt(cell[reference] / cell).astype(np.float32),
    )


def line_widths(geometry: SweepGeometry, beam: Beam) -> NDArray[np.float64]:
    """Return the beam's (samples,) lateral standard deviations, in lines."""
    depths = geometry.sample_pitch * np.arange(geometry.samples)
    radii = np.maximum(geometry.array_radius + depths, geometry.sample_pitch)
    return beam.lateral / (geometry.line_pitch * radii)


def frame_poses(
    geometry: SweepGeometry, X_TP: NDArray[np.float64], part: slice
) -> NDArray[np.float64]:
    """Return (n, 3, 4) poses of the tissue in F, of (n, 4, 4) poses of the probe in the tissue."""
    theta = geometry.line_angles(1).mean(axis=1)[part]
    X_FP = np.zeros((len(theta), 4, 4))
    X_FP[:, 0, 0] = X_FP[:, 3, 3] = 1
    X_FP[:, 1, 1] = X_FP[:, 2, 2] = np.cos(theta)
    X_FP[:, 1, 2] = np.sin(theta)
    X_FP[:, 2, 1] = -np.sin(theta)
    X_FP[:, :, 3] += X_FP[:, :, 1] * geometry.motor_radius
    return np.ascontiguousarray((X_FP @ np.linalg.inv(X_TP))[:, :3])


def line_rays(
    geometry: SweepGeometry, direction: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (frames, lines, 3) origins on the face and unit directions of all lines, in P."""
    frames, lines, _ = np.ogrid[: geometry.frames, : geometry.lines, :1]
    start = geometry.position(frames, lines, 0, direction)[:, :, 0]
    along = geometry.position(frames, lines, 1, direction)[:, :, 0] - start
    return start, along / geometry.sample_pitch
