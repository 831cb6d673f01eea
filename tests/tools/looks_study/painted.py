"""Painted volumes: shapes drawn as amplitudes in white noise, blurred, and log-compressed.

They are the second generator of the fit. It shares nothing with the project's scanner, nor with
`independent_images`, which judge the result: echoes are painted on the volume's own grid, without
beams.
"""

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform
from scipy.ndimage import gaussian_filter

from sonoservo.systems.signals import Volume

SHAPE = (88, 76, 58)


@dataclass
class Painted:
    volume: Volume
    ends: np.ndarray | None  # (2, 3) entry and tip of the needle in P, in m


class Canvas:
    """Amplitudes of diffuse and of coherent echoes on a grid of (i, j, k, 3) positions in m."""

    def __init__(self, rng):
        self.rng = rng
        self.spacing = rng.uniform(0.55e-3, 0.8e-3, 3)
        self.extent = self.spacing * (np.array(SHAPE) - 1)
        axes = [
            h * np.arange(n, dtype=np.float32) for h, n in zip(self.spacing, SHAPE, strict=True)
        ]
        self.p = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
        self.diffuse = np.ones(SHAPE, np.float32)
        self.coherent = np.zeros(SHAPE, np.float32)
        self.passing = np.ones(SHAPE, np.float32)

    def waves(self, length):
        """A smooth random function of position, of unit size."""
        k = self.rng.normal(size=(4, 3)).astype(np.float32) / length
        phases = self.rng.uniform(0, 6.3, 4)
        return (
            sum(np.sin(self.p @ each + phase) for each, phase in zip(k, phases, strict=True)) / 1.4
        )

    def place(self):
        return self.rng.uniform(0.1, 0.9, 3) * self.extent

    def shade(self, here, share):
        """Let only a share of the sound pass what lies here."""
        covered = np.cumsum(here, axis=1) > 0
        self.passing *= np.where(covered & ~here, np.float32(1 - share), np.float32(1))

    def sheet(self):
        """A fascia: a thin, wavy layer, more or less rough, of limited size."""
        normal = self.rng.normal(size=3) * [0.5, 1, 0.5]
        normal /= np.linalg.norm(normal)
        away = self.p - self.place()
        height = away @ normal + self.waves(12e-3) * self.rng.uniform(0.1e-3, 1e-3)
        here = np.abs(height) < self.rng.uniform(0.3e-3, 0.7e-3)
        here &= np.linalg.norm(away, axis=-1) < self.rng.uniform(8e-3, 40e-3)
        self._echo(here, self.rng.uniform(8, 26))
        if self.rng.random() < 0.3:
            self.shade(here, self.rng.uniform(0.1, 0.5))

    def tube(self):
        """A vessel: a dark lumen, perhaps with bright walls."""
        k = self.rng.normal(size=3) * [1, 0.4, 1]
        away = self.p - self.place()
        k /= np.linalg.norm(k)
        from_axis = np.linalg.norm(away - (away @ k)[..., None] * k, axis=-1)
        radius = self.rng.uniform(1e-3, 5e-3)
        self.diffuse[from_axis < radius] *= self.rng.uniform(0.02, 0.2)
        wall = np.abs(from_axis - radius) < 0.4e-3
        facing = np.abs(away[..., 1]) > 0.8 * from_axis
        self._echo(wall & facing, self.rng.uniform(5, 22))

    def bone(self):
        """A bright, bent surface above a shadow."""
        centre, depth = self.place(), self.rng.uniform(0.3, 0.9) * self.extent[1]
        away = (self.p - centre)[..., [0, 2]] @ (self.rng.normal(size=(2, 2)) / 14e-3)
        surface = depth + 4e-3 * np.sum(away**2, -1) + 0.4e-3 * self.waves(8e-3)
        inside = (self.p[..., 1] > surface) & (np.sum(away**2, -1) < self.rng.uniform(0.5, 3))
        self._echo(inside & (self.p[..., 1] < surface + 0.8e-3), self.rng.uniform(18, 32))
        self.shade(inside, self.rng.uniform(0.9, 1.0))

    def grain(self):
        """A calcification, a bubble or a short fibre, with or without a shadow or a tail."""
        centre = self.place()
        k = self.rng.normal(size=3)
        length = self.rng.choice([0.0, self.rng.uniform(2e-3, 14e-3)])
        here = self._rod(
            centre, centre + length * k / np.linalg.norm(k), self.rng.uniform(0.4e-3, 1.5e-3)
        )
        self._echo(here, self.rng.uniform(12, 30))
        if self.rng.random() < 0.4:
            self.shade(here, self.rng.uniform(0.3, 1.0))
        elif self.rng.random() < 0.4:
            tail = np.maximum.accumulate(here, axis=1)
            self.diffuse[tail] *= self.rng.uniform(1.5, 4)

    def border(self):
        """Two tissues of unlike levels, and perhaps fibres in one of them."""
        normal = self.rng.normal(size=3)
        side = (self.p - self.place()) @ normal + 3e-3 * self.waves(20e-3) > 0
        self.diffuse[side] *= 10 ** (self.rng.uniform(-14, 8) / 20)

    def fibres(self):
        """Muscle: many weak layers and lines of one direction."""
        normal = self.rng.normal(size=3) * [0.3, 1, 0.3]
        normal /= np.linalg.norm(normal)
        phase = (self.p @ normal) / self.rng.uniform(2e-3, 5e-3) + 0.4 * self.waves(12e-3)
        bright = np.sin(2 * np.pi * phase) > 0.9
        bright &= self.waves(6e-3) > self.rng.uniform(0, 0.8)
        self.diffuse[bright] *= self.rng.uniform(2, 5)

    def _rod(self, a, b, radius):
        k = b - a
        s = np.clip((self.p - a) @ k / max(k @ k, 1e-12), 0, 1)
        return np.linalg.norm(self.p - a - s[..., None] * k, axis=-1) < radius

    def _echo(self, here, level, steady=None):
        """Brighten what lies here, partly as a mirror does, unevenly."""
        amplitude = 10 ** (level / 20) * np.exp(0.35 * self.waves(self.rng.uniform(3e-3, 15e-3)))
        coherent = self.rng.uniform(0, 0.7) if steady is None else steady
        self.coherent[here] += (coherent * amplitude)[here]
        self.diffuse[here] += ((1 - coherent) * amplitude)[here]

    def needle(self):
        """A needle from a side, 15 mm or longer, with gaps; its (2, 3) ends in m."""
        while True:
            k = self.rng.normal(size=3)
            dip = np.radians(self.rng.uniform(-5, 55))
            flat = k[[0, 2]] / np.hypot(k[0], k[2])
            k = np.array([np.cos(dip) * flat[0], np.sin(dip), np.cos(dip) * flat[1]])
            middle = self.rng.uniform(0.2, 0.8, 3) * self.extent
            with np.errstate(divide="ignore"):
                stops = np.where(k > 0, self.extent - middle, -middle) / k
                starts = np.where(k > 0, -middle, self.extent - middle) / k
            first, last = starts.max(), stops.min()
            side = np.argmax(starts)
            if side != 1 and last - first > 20e-3:
                break
        # One in five goes on through the volume.
        length = min(self.rng.uniform(15e-3, 1.2 * (last - first)), last - first)
        ends = middle + np.outer([first, first + length], k)
        here = self._rod(*ends, self.rng.uniform(0.4e-3, 0.75e-3))
        level = self.rng.uniform(6, 26) - 0.12 * max(np.degrees(dip) - 20, 0)
        shown = self.waves(self.rng.uniform(4e-3, 12e-3)) > self.rng.uniform(-1.6, -0.5)
        self._echo(here & shown, level, steady=self.rng.uniform(0.2, 0.9))
        for n in range(1, self.rng.integers(1, 4)):  # reverberation
            below = np.roll(here & shown, n * int(1.5e-3 / self.spacing[1]), axis=1)
            self._echo(below, level - 9 * n, steady=0.5)
        self.shade(here, self.rng.uniform(0, 0.6))
        return ends

    def volume(self, needle):
        """Return the blurred, log-compressed volume with its needle."""
        rng = self.rng
        names = ["sheet", "sheet", "tube", "bone", "grain", "grain", "border", "fibres"]
        count = rng.integers(1, 7) if rng.random() < 0.5 else 0
        for name in rng.choice(names, count):
            getattr(self, name)()
        if rng.random() < 0.2:  # water
            self.diffuse *= 0.02
        ends = self.needle() if needle else None
        noise = rng.normal(size=(4, *SHAPE)).astype(np.float32)
        echo = self.diffuse * (noise[0] + 1j * noise[1])
        sigma = rng.uniform([0.5e-3, 0.25e-3, 0.6e-3], [1.0e-3, 0.45e-3, 1.5e-3]) / self.spacing
        # A mirror's echoes add up in phase, speckle's in power.
        cells = np.sqrt(np.prod(2 * np.sqrt(np.pi) * sigma))
        echo = (echo * self.passing) * cells / np.sqrt(2) + self.coherent * self.passing * 1.5
        echo = gaussian_filter(echo.real, sigma) + 1j * gaussian_filter(echo.imag, sigma)
        fall = rng.uniform(-6, 2) * self.p[..., 1] / self.extent[1]
        level = 20 * np.log10(np.abs(echo) + 1e-4) + fall
        level = 20 * np.log10(10 ** (level / 20) + 10 ** (rng.uniform(-40, -18) / 20)
                              * np.abs(noise[2] + 1j * noise[3]))  # fmt: skip
        range_db = rng.uniform(45, 75)
        grey = (level + rng.uniform(0.3, 0.6) * range_db) * 255 / range_db
        grey = np.clip(np.round(grey), 0, 255).astype(np.uint8)
        seen = np.ones(SHAPE, bool)
        if rng.random() < 0.6:  # a sector
            angle, above = rng.uniform(0.3, 0.7), rng.uniform(5e-3, 40e-3)
            x, y, z = np.moveaxis(self.p, -1, 0)
            wide = 0.5 * self.extent / (self.extent[1] + above)
            seen = np.abs(x - self.extent[0] / 2) < (1 + angle) * wide[0] * (y + above)
            seen &= np.abs(z - self.extent[2] / 2) < (1 + angle) * wide[2] * (y + above)
        return Painted(
            Volume(np.where(seen, grey, 0), np.zeros(3), self.spacing, RigidTransform(), 0.0,
                   decibels_per_level=range_db / 255, mask=seen),
            ends,
        )  # fmt: skip


def painted(seed, needle):
    """Return a painted volume, with or without a needle."""
    return Canvas(np.random.default_rng([seed, int(needle), 13])).volume(needle)
