"""Structures of the tissue: what they scatter, what they reflect, and how much sound they pass.

All levels are relative to the tissue. Positions are in the world, unless a structure is an artefact
of the probe.
"""

import numpy as np


def decibels(level):
    """Amplitude of a level in dB."""
    return np.float32(10 ** (np.asarray(level) / 20))


class Waves:
    """Smooth random function of position, of unit variance: a sum of plane waves."""

    def __init__(self, rng, length, axes=(0, 1, 2), count=6):
        self.vectors = np.zeros((count, 3), np.float32)
        self.vectors[:, axes] = rng.normal(size=(count, len(axes))) / length
        self.phases = rng.uniform(0, 2 * np.pi, count).astype(np.float32)

    def __call__(self, p):
        waves = zip(self.vectors, self.phases, strict=True)
        total = sum(np.sin(p @ v + phase) for v, phase in waves)
        return total * np.sqrt(np.float32(2 / len(self.vectors)))

    def over(self, p, block=3):
        """Values on a (samples, lines, frames, 3) grid, constant over blocks of samples."""
        total = self(p[tuple(slice(min(n, block) // 2, None, block) for n in p.shape[:3])])
        for axis, n in enumerate(p.shape[:3]):
            total = np.repeat(total, block, axis)
            total = total.take(np.minimum(range(n), total.shape[axis] - 1), axis)
        return total


class Medium:
    """Amplitudes at the samples of the beams: of what scatters, what reflects and what passes."""

    def __init__(self, p, pitch):
        self.p, self.pitch = p, pitch
        self.scattering = np.ones(p.shape[:3], np.float32)
        self.reflecting = np.zeros(p.shape[:3], np.float32)
        self.passing = np.ones(p.shape[:3], np.float32)

    def shell(self, distance):
        """Weight of the samples at a surface, from the (signed) distance to it."""
        return np.clip(1 - np.abs(distance) / self.pitch, 0, 1)

    def block(self, blocked, amplitude):
        """Let a share of the amplitude through beneath an obstacle."""
        beneath = np.maximum.accumulate(blocked, axis=0) & ~blocked
        self.passing *= np.where(beneath, amplitude, 1)

    def brighten(self, weight, level, mirror):
        """Add a reflector of a level in dB, a share of which is like a mirror."""
        self.reflecting += np.float32(mirror) * decibels(level) * weight
        self.scattering += np.float32(1 - mirror) * decibels(level) * weight


class Layers:
    """Layers and patches of tissue of different brightness."""

    def __init__(self, rng, extent):
        self.waves = Waves(rng, 8e-3), Waves(rng, 5e-3, axes=(1,), count=3)
        self.size = rng.uniform(0.3, 1.5, 2).astype(np.float32)

    def apply(self, medium):
        level = sum(s * wave.over(medium.p) for s, wave in zip(self.size, self.waves, strict=True))
        medium.scattering *= decibels(level)


class Sheet:
    """Curved sheet across the sound."""

    def __init__(self, rng, extent, depth, tilt, bow, wave):
        self.middle = extent * np.array([rng.uniform(-0.2, 0.2), depth, rng.uniform(-0.2, 0.2)])
        self.slope = np.tan(np.radians(rng.uniform(-tilt, tilt, 2)))
        self.bow = rng.uniform(0, bow, 2)
        self.waves, self.wave = Waves(rng, 6e-3, axes=(0, 2)), wave

    def distance(self, p):
        """Distance beneath the sheet, in m."""
        x, y, z = np.moveaxis(p - self.middle.astype(np.float32), -1, 0)
        surface = self.slope[0] * x + self.slope[1] * z
        surface = surface + 0.5 * (self.bow[0] * x**2 + self.bow[1] * z**2)
        return (y - surface - self.wave * self.waves.over(p)).astype(np.float32)


class Bone(Sheet):
    """Bone: a bright, bowed surface, and almost no sound beneath it."""

    def __init__(self, rng, extent):
        super().__init__(rng, extent, rng.uniform(0.6, 0.85), 15, 40, 0.15e-3)
        self.side = rng.normal(size=3) * [1, 0, 1]
        self.reach = rng.uniform(-0.1, 0.4) * extent[0]
        self.level, self.through = rng.uniform(18, 30), decibels(rng.uniform(-35, -18))
        self.patches = Waves(rng, 3e-3)

    def apply(self, medium):
        away = self.distance(medium.p)
        side = self.side / np.linalg.norm(self.side)
        there = (medium.p @ side.astype(np.float32)) < self.reach
        shine = decibels(2 * self.patches.over(medium.p)) * there
        medium.brighten(medium.shell(away) * shine, self.level, 0.5)
        medium.block((np.abs(away) < medium.pitch) & there, self.through)


class Fascia(Sheet):
    """Fascia: a thin bright sheet with gaps, which sound passes."""

    def __init__(self, rng, extent):
        super().__init__(rng, extent, rng.uniform(0.1, 0.9), 20, 15, rng.uniform(0.1e-3, 0.5e-3))
        self.level, self.mirror = rng.uniform(6, 16), rng.uniform(0.2, 0.8)
        self.patches = Waves(rng, 3e-3)

    def apply(self, medium):
        patchy = medium.shell(self.distance(medium.p))
        near = patchy > 0
        patchy[near] *= np.clip(0.6 + 0.5 * self.patches(medium.p[near]), 0, 1.5)
        medium.brighten(patchy, self.level, self.mirror)


class Vessel:
    """Vessel: a tube without echoes, with walls that are brightest where the sound meets them."""

    def __init__(self, rng, extent):
        self.middle = extent * rng.uniform([-0.3, 0.25, -0.3], [0.3, 0.8, 0.3])
        k = rng.normal(size=3) * [1, 0.3, 1]
        self.k = (k / np.linalg.norm(k)).astype(np.float32)
        self.radius = rng.uniform(1.2e-3, 3.5e-3)
        self.inside, self.level = decibels(rng.uniform(-35, -18)), rng.uniform(6, 16)

    def apply(self, medium):
        v = medium.p - self.middle.astype(np.float32)
        v -= (v @ self.k)[..., None] * self.k
        away = np.sqrt(np.einsum("...i,...i", v, v))
        medium.scattering *= np.where(away < self.radius, self.inside, 1)
        facing = np.abs(v[..., 1]) / np.maximum(away, 1e-6)
        medium.brighten(medium.shell(away - self.radius) * facing**2, self.level, 0.5)


class Calcification:
    """Calcification: a bright clump with a shadow."""

    def __init__(self, rng, extent):
        self.middle = extent * rng.uniform([-0.4, 0.15, -0.4], [0.4, 0.9, 0.4])
        self.radii = rng.uniform(0.4e-3, 2e-3, 3)
        self.level, self.through = rng.uniform(10, 24), decibels(rng.uniform(-15, -3))

    def apply(self, medium):
        v = (medium.p - self.middle.astype(np.float32)) / self.radii.astype(np.float32)
        inside = np.einsum("...i,...i", v, v) < 1
        medium.brighten(inside, self.level, 0.2)
        medium.block(inside, self.through)


class NearField:
    """Echoes that run back and forth between the face and a layer beneath it."""

    def __init__(self, rng, extent):
        self.depth, self.repeats = rng.uniform(3e-3, 9e-3), rng.integers(2, 6)
        self.level, self.loss = rng.uniform(12, 22), rng.uniform(2, 5)
        self.patches = Waves(rng, 6e-3, axes=(0, 2))

    def apply(self, medium):
        r = medium.pitch * np.arange(len(medium.p), dtype=np.float32)[:, None, None]
        strength = decibels(2 * self.patches(medium.p[:1]))
        for n in range(1, self.repeats + 1):
            weight = medium.shell(r - n * self.depth) * strength
            medium.brighten(weight, self.level - n * self.loss, 0.7)


class RingDown:
    """Comet tail of a gas bubble or a clip: a bright streak along the lines beneath it."""

    def __init__(self, rng, extent):
        self.middle = extent * rng.uniform([-0.35, 0.1, -0.35], [0.35, 0.5, 0.35])
        self.step, self.length = rng.uniform(0.6e-3, 2e-3), rng.uniform(6e-3, 25e-3)
        self.level, self.size = rng.uniform(14, 24), rng.uniform(0.5e-3, 1.2e-3)

    def apply(self, medium):
        near = np.linalg.norm(medium.p - self.middle.astype(np.float32), axis=-1)
        top, line, frame = np.unravel_index(near.argmin(), near.shape)
        if near.min() > 2e-3:
            return
        count = int(self.length / self.step)
        for n in range(count):
            at = top + round(n * self.step / medium.pitch)
            if at < len(near):
                level = self.level - 14 * n / count
                medium.reflecting[at, line, frame] += decibels(level) * self.size / 0.3e-3


KINDS = {
    "bone": (Bone, 1, 1),
    "fascia": (Fascia, 1, 3),
    "vessels": (Vessel, 1, 2),
    "calcifications": (Calcification, 1, 5),
    "reverberation": (NearField, 1, 1),
    "ring_down": (RingDown, 1, 2),
}
"""Class of each kind of structure, and the least and largest number of them."""


def draw_structures(rng, kinds, extent):
    """Structures of the named kinds in tissue of (3,) extents in m; X and Z are centred."""
    extent = np.asarray(extent)
    found = [Layers(rng, extent)]
    for kind in kinds:
        make, least, most = KINDS[kind]
        found += [make(rng, extent) for _ in range(rng.integers(least, most + 1))]
    return found
