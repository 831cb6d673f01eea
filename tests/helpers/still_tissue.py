"""Tissue that stands still, seen by a wandering probe whose poses are late and ill calibrated."""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from scipy.ndimage import gaussian_filter, map_coordinates
from synthetic_volumes import GEOMETRY, grid

from sonoservo.systems.recording import Recording, RecordingWriter
from sonoservo.systems.signals import SweepMotion, Volume
from sonoservo.systems.signals.immutable import seal

PITCH = 1e-3
STEP = 1e-3
PERIOD = 0.303


@lru_cache
def speckle():
    """Decibels on a lattice of W, as fine as a beam is wide, and its first position."""
    low, spacing, p_P, _ = grid(PITCH)
    high = low + spacing * (np.array(p_P.shape[:3]) - 1)
    low, high = low - 15e-3, high + 15e-3
    shape = np.ceil((high - low) / STEP).astype(int) + 1
    rng = np.random.default_rng(7)
    parts = [gaussian_filter(rng.normal(size=shape).astype(np.float32), 0.8) for _ in range(2)]
    power = parts[0] ** 2 + parts[1] ** 2
    return 10 * np.log10(power / power.mean() + 1e-3), low


def wandering(time):
    """True pose of the probe: it sways along and about all axes."""
    waves = np.sin(2 * np.pi * np.outer([0.31, 0.23, 0.37, 0.29, 0.19, 0.41], [time])[:, 0] + 0.4)
    angles = np.deg2rad([2.5, 3.0, 2.5]) * waves[:3]
    return RigidTransform(RollPitchYaw(angles), np.array([3e-3, 1.5e-3, 2.5e-3]) * waves[3:])


def swept(path, number):
    """Motion of the sweep of a number along a path."""
    direction = 1 if number % 2 == 0 else -1
    times = PERIOD * number + direction * GEOMETRY.frame_period * (np.arange(GEOMETRY.frames) - 12)
    return SweepMotion(GEOMETRY, direction, times, [path(t).GetAsMatrix4() for t in times])


@lru_cache(maxsize=64)
def shown(path, number):
    """Grey levels of a volume from true poses, which no error of the measured ones changes."""
    low, spacing, p_P, inside = grid(PITCH)
    p_W = swept(path, number).to_world(p_P[inside])[0]
    decibels, first = speckle()
    seen = map_coordinates(decibels, ((p_W - first) / STEP).T, order=1, mode="nearest")
    seen += 1.5 * np.random.default_rng(number).normal(size=seen.shape)
    grey = np.zeros(inside.shape, np.uint8)
    grey[inside] = np.clip(np.round((seen + 40) * 255 / 60), 1, 255)
    return seal(grey), low, spacing


@dataclass(frozen=True)
class LyingProbe:
    """Makes volumes from true poses, and labels them with measured ones."""

    delay: float = 0.0
    X_PI: RigidTransform = field(default_factory=RigidTransform)
    path: object = wandering

    def measured(self, time):
        return self.path(time - self.delay).multiply(self.X_PI.inverse())

    def volume(self, number):
        motion = swept(self.measured, number)
        grey, low, spacing = shown(self.path, number)
        middle = float(motion.times[12])
        return Volume(grey, low, spacing, self.measured(middle), middle, motion)

    def record(self, path, count):
        """Recording of the first volumes."""
        with RecordingWriter(path) as writer:
            for number in range(count):
                writer.append(self.volume(number))
        return Recording(path)
