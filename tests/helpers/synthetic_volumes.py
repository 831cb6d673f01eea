"""Volumes with a needle, made without the scanner: a closed-form blurred line in speckle."""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from pydrake.math import RigidTransform
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from sonoservo.systems.signals import SweepGeometry, SweepMotion, Volume

GEOMETRY = SweepGeometry(
    array_radius=40e-3,
    motor_radius=27.25e-3,
    line_pitch=np.deg2rad(0.608768),
    frame_pitch=np.deg2rad(1.4634),
    sample_pitch=0.308e-3,
    lines=96,
    frames=25,
    samples=293,
    frame_period=0.0121,
)


@lru_cache
def grid(spacing=0.75e-3):
    corners = GEOMETRY.position(*np.meshgrid([0, 24], [0, 47.5, 95], [0, 292]), 1).reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    low[1] = 0.0
    shape = tuple(np.ceil((high - low) / spacing).astype(int) + 1)
    axes = [low[i] + spacing * np.arange(shape[i]) for i in range(3)]
    p_P = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return low, np.full(3, spacing), p_P, GEOMETRY.contains(p_P)


@lru_cache(maxsize=4)
def speckle(seed, spacing=0.75e-3):
    """Complex amplitude of unit power: static tissue."""
    rng = np.random.default_rng(seed)
    shape = grid(spacing)[3].shape
    sigma = np.array([1.9e-3, 0.45e-3, 2.3e-3]) / 2.355 / spacing
    field_ = [gaussian_filter(rng.normal(size=shape).astype(np.float32), sigma) for _ in range(2)]
    amplitude = field_[0] + 1j * field_[1]
    return (amplitude / np.sqrt(np.mean(np.abs(amplitude) ** 2))).astype(np.complex64)


def line(p, a, b, amplitude, sigma=0.85e-3):
    """Amplitude of a blurred line from a to b on a grid; half of the line's own where it ends."""
    k = (b - a) / np.linalg.norm(b - a)
    reach = 6 * sigma  # beyond it, less than a 10^7th is left
    axes = p[:, 0, 0, 0], p[0, :, 0, 1], p[0, 0, :, 2]
    limits = np.transpose([np.minimum(a, b) - reach, np.maximum(a, b) + reach])
    near = tuple(slice(*np.searchsorted(*each)) for each in zip(axes, limits, strict=True))
    s = (p[near] - a) @ k
    d2 = np.sum((p[near] - a) ** 2, axis=-1) - s**2
    ends = ndtr(s / sigma) - ndtr((s - np.linalg.norm(b - a)) / sigma)
    whole = np.zeros(p.shape[:-1])
    whole[near] = amplitude(s) * np.exp(-d2 / (2 * sigma**2)) * ends
    return whole


@dataclass
class Scene:
    """Static tissue, inclusions, and a needle whose tip moves."""

    seed: int = 0
    balls: list = field(default_factory=list)
    rods: list = field(default_factory=list)
    spacing: float = 0.75e-3
    level_db: float = 14.0

    @cached_property
    def _tissue(self):
        """Complex amplitude of all that never moves."""
        amplitude, p_P = speckle(self.seed, self.spacing).copy(), grid(self.spacing)[2]
        for centre, radius in self.balls:
            near = np.linalg.norm(p_P - centre, axis=-1)
            amplitude += 30 * np.exp(-(np.maximum(near - radius, 0) ** 2) / (2 * (0.8e-3) ** 2))
        for a, b in self.rods:
            amplitude += line(p_P, np.array(a), np.array(b), lambda s: 30.0)
        return amplitude

    def volume(self, number, needle=None, X_WP=None, period=0.303, noise=0.02):
        """One volume. The needle is a function of time that returns its ends in W, or None."""
        low, spacing, p_P, inside = grid(self.spacing)
        X_WP = X_WP or RigidTransform()
        direction = 1 if number % 2 == 0 else -1
        frames = np.arange(GEOMETRY.frames)
        times = period * number + direction * GEOMETRY.frame_period * (frames - 12)
        poses = np.repeat(X_WP.GetAsMatrix4()[np.newaxis], GEOMETRY.frames, axis=0)
        motion = SweepMotion(GEOMETRY, direction, times, poses)
        amplitude = self._tissue.copy()
        rng = np.random.default_rng([self.seed, number])
        ends = needle and needle_as_acquired(needle, motion, X_WP)
        if ends:
            a, b = ends

            def level(s):
                # Specular over some millimetres, diffuse with fading elsewhere.
                centre = 0.6 * np.linalg.norm(b - a)
                fading = 1 + 0.15 * np.sin(s / 1.7e-3) + 0.1 * np.sin(s / 0.9e-3 + 1)
                return 7 * fading + 60 * np.exp(-((s - centre) ** 2) / (2 * (4e-3) ** 2))

            amplitude += line(p_P, a, b, level)
        amplitude += noise * rng.normal(size=amplitude.shape)
        grey = (20 * np.log10(np.abs(amplitude) + 1e-6) + self.level_db) * 255 / 60
        grey = np.where(inside, np.clip(np.round(grey), 1, 255), 0).astype(np.uint8)
        return Volume(grey, low, spacing, X_WP, motion.time, motion)


def needle_as_acquired(needle, motion, X_WP):
    """Ends of a needle in P, the tip when it is acquired."""
    time = motion.time
    for _ in range(4):
        ends = needle(time)
        if ends is None:
            return None
        a, b = X_WP.inverse().multiply(np.array(ends).T).T
        time = motion.to_world(b[np.newaxis])[1][0]
    return a, b


def entry_on_side():
    """A position on the lateral side of the sector (towards -X), 45 mm deep."""
    return GEOMETRY.position(12, 0, 45e-3 / GEOMETRY.sample_pitch, 1)


ENTRY = entry_on_side()
K = np.array([1, 0.25, 0.1]) / np.linalg.norm([1, 0.25, 0.1])
"""Where a needle enters the sector, and its direction."""
