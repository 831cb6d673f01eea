"""Needle as a reflecting line: its path, its echo, and the truth about it."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter

from .beams import sample, splat
from .structures import decibels

DIAMETERS = (
    2.108e-3, 1.829e-3, 1.651e-3, 1.473e-3, 1.270e-3, 1.067e-3, 0.908e-3, 0.819e-3, 0.718e-3,
    0.642e-3, 0.566e-3, 0.515e-3,
)  # fmt: skip
"""Outer diameters of gauges 14 to 25, in m (Birmingham wire gauge)."""

TIPS = ("bevel", "bright", "abrupt")

VISIBLE = 6.0
"""Contrast with the tissue from which a needle counts as visible, in dB."""

_STEP = 0.1e-3
_TABLE = 0.25e-3


@dataclass(frozen=True)
class Truth:
    """Needle in one volume; positions in W, in m."""

    entry: np.ndarray  # where it enters the field of view
    tip: np.ndarray
    curve: np.ndarray  # (m, 3) points of its axis from entry to tip, 0.5 mm apart
    contrast: np.ndarray  # (m,) of its echo with the tissue and noise around it, in dB
    radius: float  # the echo comes from the wall rather than from the axis

    @property
    def visible(self):
        """(m,) flags of the points at which the needle stands out."""
        return self.contrast >= VISIBLE

    @property
    def length(self):
        return float(np.linalg.norm(self.tip - self.entry))


class Needle:
    """Steel needle on a fixed path.

    The shaft reflects like a mirror, most where the sound meets it at a right angle, and
    scatters from its rough surface at any angle. Its front wall echoes most, then its rear wall,
    and below them the sound that ran back and forth inside (comet tail). Its median contrast with
    tissue is a level in dB when it is pushed in by its length, in m.
    """

    outside = 40e-3

    def __init__(self, rng, entry, direction, length, level):
        self.entry, self.direction, self.length, self.level = entry, direction, length, level
        aside = np.cross(direction, rng.normal(size=3))
        curvature = rng.uniform(0, 1.2) * (rng.random() < 0.6)
        self.curvature = curvature * aside / np.linalg.norm(aside)
        self.radius = float(rng.choice(DIAMETERS)) / 2
        self.tip = str(rng.choice(TIPS))
        self.bevel, self.tip_gain = rng.uniform(2, 5) * self.radius, rng.uniform(3, 9)
        self.mirror_angle, self.rough = rng.uniform(8, 20), decibels(rng.uniform(-20, -8))
        self.fading = rng.uniform(-2, 8)
        self.rear = decibels(rng.uniform(-14, -4)) * np.exp(2j * np.pi * rng.random())
        self.repeats, self.loss = int(rng.integers(2, 5)), rng.uniform(4, 9)
        self.gap = max(2 * self.radius * rng.uniform(0.8, 1.6), 0.5e-3)
        self.turns = np.exp(2j * np.pi * rng.random(8))
        self.shade = rng.uniform(0.05, 0.4)
        count, grain = int(0.2 / _TABLE), rng.uniform(0.8e-3, 3e-3) / _TABLE
        beads = [_smooth(rng.normal(size=count), grain) for _ in range(3)]
        coherence = rng.uniform(0.6, 0.97)
        rough = (beads[1] + 1j * beads[2]) * np.sqrt(0.5 * (1 - coherence**2))
        self.table = decibels(rng.uniform(1, 3) * beads[0]) * (coherence + rough)
        self.gain = 1.0

    def position(self, s):
        """(m, 3) points of the axis at distances s beyond the entry."""
        s = np.asarray(s, float)[..., None]
        return self.entry + s * self.direction + 0.5 * s * np.abs(s) * self.curvature

    def amplitude(self, s, inserted, tilt):
        """(m,) complex amplitudes of the shaft's echo at distances beyond the entry, in m.

        ``tilt``: (m,) sines of the angles between the shaft and the plane across the beam.
        """
        before = inserted - s
        at = before / _TABLE
        table = np.interp(at, np.arange(len(self.table)), self.table)
        angle = np.degrees(np.arcsin(np.clip(np.abs(tilt), 0, 1)))
        mirror = np.exp(-((angle / self.mirror_angle) ** 2))
        fading = decibels(-self.fading * s / self.length)
        end = np.ones_like(s)
        if self.tip == "bevel":
            end = np.clip(0.25 + 0.75 * before / self.bevel, 0.25, 1)
        elif self.tip == "bright":
            end = decibels(self.tip_gain * (before < 1e-3))
        return table * (mirror + self.rough) * fading * end

    def shaft(self, beams, X_PT, inserted):
        """Distances beyond the entry, positions and wall offsets in P of the shaft in view."""
        s = np.arange(-self.outside, inserted, _STEP)
        ends = self.position(np.array([inserted]))
        p = X_PT.multiply(np.concatenate([self.position(s), ends]).T).T
        s = np.append(s, inserted)
        inside = beams.contains(p)
        # What leaves the view and comes back is not drawn.
        away = np.flatnonzero(~inside)
        first = away[-1] + 1 if len(away) else 0
        along = np.gradient(p, axis=0)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        beam = beams.direction(p)
        tilt = np.einsum("mi,mi->m", along, beam)
        wall = beam - tilt[:, None] * along
        wall *= self.radius / np.maximum(np.linalg.norm(wall, axis=1, keepdims=True), 1e-3)
        return s[first:], p[first:], wall[first:], beam[first:], tilt[first:]

    def draw(self, scene, X_PT, inserted, medium):
        """Complex echo of the needle, share of the amplitude that passes it, and (p_P, contrast).

        None if the needle is not in view.
        """
        beams = scene.beams
        s, p, wall, beam, tilt = self.shaft(beams, X_PT, inserted)
        if len(s) < 10:
            return None
        passing = sample(medium.passing, beams.index(p))
        amplitude = self.gain * self.amplitude(s, inserted, tilt) * passing
        parts = [(p - wall, amplitude), (p + wall, amplitude * self.rear)]
        for n in range(1, self.repeats + 1):
            turn = self.turns[n] * decibels(-self.loss * (n + 0.5))
            parts.append((p + wall + n * self.gap * beam, amplitude * turn))
        index = np.concatenate([beams.index(points) for points, _ in parts], axis=1)
        scatterers = splat(beams.shape, index, np.concatenate([each for _, each in parts]))
        margin = int(np.ceil(2e-3 / beams.pitch[0]))
        first = max(0, int(index[0].min()) - margin)
        echo = scene.blur(scatterers, first, int(index[0].max()) + margin)
        contrast = self._contrast(scene, echo, p, wall, medium)
        return echo, self._transmission(beams, p), (p, contrast)

    def _transmission(self, beams, p):
        """Share of the amplitude that passes the needle."""
        index = np.round(beams.index(p)).astype(int).clip(0, np.array(beams.shape)[:, None] - 1)
        depth = np.full(beams.shape[1:], beams.shape[0], float)
        np.minimum.at(depth, (index[1], index[2]), index[0])
        depth = minimum_filter(depth, 3) + 2
        beneath = np.arange(beams.shape[0])[:, None, None] > depth
        return np.where(beneath, np.float32(1 - self.shade), np.float32(1))

    @staticmethod
    def _contrast(scene, echo, p, wall, medium):
        """(m,) contrast in dB of the shaft with the tissue and noise around it."""
        noise = np.broadcast_to(scene.display.noise_amplitude(len(echo)), echo.shape)
        around = np.hypot(medium.scattering * medium.passing, noise)
        level = np.abs(echo)
        walls = [sample(level, scene.beams.index(p + side * wall)) for side in (-1, 0, 1)]
        ratio = np.max(walls, axis=0) / sample(around, scene.beams.index(p))
        return 20 * np.log10(np.maximum(ratio, 1e-3))

    def calibrate(self, scene, X_PT, medium):
        """Set the gain such that the shaft has its level over tissue without a shadow."""
        _, _, (p, contrast) = self.draw(scene, X_PT, self.length, medium)
        clear = sample(medium.passing, scene.beams.index(p)) > 0.9
        usual = np.median(contrast[clear] if clear.any() else contrast)
        self.gain *= float(decibels(self.level - usual))


def _smooth(values, sigma):
    """Smooth random numbers to unit variance."""
    values = gaussian_filter1d(values, sigma)
    return values / values.std()
