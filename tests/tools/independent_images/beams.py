"""Beams of a 3D probe: their geometry, their point spread, and the image made of their echoes.

Arrays over the beams have the shape (samples, lines, frames). Positions are in the probe frame: X
along the array, Y into the body, Z across the frames.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import map_coordinates

FWHM = float(np.sqrt(8 * np.log(2)))
"""Full width at half maximum of a Gaussian, in standard deviations."""


@dataclass(frozen=True)
class Beams:
    """Beams that fan out along the array and across the frames, in m and rad."""

    radii: tuple[float, float]  # behind the face, whence lines and frames seem to come
    angles: tuple[float, float]  # half of the fans' openings
    depth: float
    pitch: tuple[float, float, float] = (0.3e-3, 0.6e-3, 0.85e-3)  # at mid-depth

    @cached_property
    def axes(self):
        """Depths of the samples in m, angles of the lines and of the frames in rad."""
        depths = np.arange(0, self.depth, self.pitch[0])
        fans = []
        for radius, angle, pitch in zip(self.radii, self.angles, self.pitch[1:], strict=True):
            half = int(np.ceil(angle * (radius + self.depth / 2) / pitch))
            fans.append(np.linspace(-angle, angle, 2 * half + 1))
        return depths, *fans

    @property
    def shape(self):
        return tuple(len(each) for each in self.axes)

    def position(self, r, phi, theta):
        """Position at depth r of the line and frame with these angles."""
        a, b = self.radii
        rho = (r + a) * np.cos(phi) - a + b
        x = (r + a) * np.sin(phi)
        return np.stack(np.broadcast_arrays(x, rho * np.cos(theta) - b, rho * np.sin(theta)), -1)

    def coordinates(self, p_P):
        """Depth and angles, in one array, of (..., 3) positions."""
        a, b = self.radii
        x, y, z = np.moveaxis(p_P, -1, 0)
        y_frame = np.hypot(y + b, z) - b
        r = np.hypot(x, y_frame + a) - a
        return np.stack([r, np.arctan2(x, y_frame + a), np.arctan2(z, y + b)])

    def index(self, p_P):
        """Fractional (3, ...) indices of (..., 3) positions."""
        found = self.coordinates(p_P)
        for i, axis in enumerate(self.axes):
            found[i] = (found[i] - axis[0]) / (axis[1] - axis[0])
        return found

    def contains(self, p_P):
        r, phi, theta = self.coordinates(p_P)
        seen = (r >= 0) & (r <= self.axes[0][-1])
        return seen & (np.abs(phi) <= self.angles[0]) & (np.abs(theta) <= self.angles[1])

    def direction(self, p_P):
        """Direction in which the sound travels at (..., 3) positions."""
        _, phi, theta = self.coordinates(p_P)
        return np.stack([np.sin(phi), np.cos(phi) * np.cos(theta), np.cos(phi) * np.sin(theta)], -1)

    @cached_property
    def grid(self):
        """(samples, lines, frames, 3) positions of all samples."""
        r, phi, theta = self.axes
        return self.position(r[:, None, None], phi[:, None], theta).astype(np.float32)

    @cached_property
    def cell(self):
        """(samples, lines, 1) size of a sample's cell, relative to that in the middle."""
        r, phi, _ = self.axes
        a, b = self.radii
        size = (r[:, None] + a) * ((r[:, None] + a) * np.cos(phi) - a + b)
        return (size / size[len(r) // 2, len(phi) // 2])[..., None].astype(np.float32)


@dataclass(frozen=True)
class PointSpread:
    """Widths in m of a point's echo, at half of its amplitude.

    Along the line the pulse keeps its length. Across it the beam is narrowest at the focus and
    widens as a Gaussian beam does, up to a limit: depth of the focus, width there, distance from it
    at which the width is sqrt(2) times as large, and largest width.
    """

    axial: float
    lateral: tuple[float, float, float, float]
    elevation: tuple[float, float, float, float]
    side_lobe: float  # amplitude

    @staticmethod
    def draw(rng, depth):
        beam = []
        for narrow, widest in (((0.8e-3, 1.6e-3), 3e-3), ((1.2e-3, 2.8e-3), 4.5e-3)):
            focus, width = depth * rng.uniform(0.3, 0.75), rng.uniform(*narrow)
            beam.append((focus, width, rng.uniform(10e-3, 30e-3), widest))
        return PointSpread(rng.uniform(0.4e-3, 0.9e-3), *beam, 10 ** (rng.uniform(-40, -26) / 20))

    @staticmethod
    def width(beam, r):
        """Width of a beam at depth r."""
        focus, narrow, reach, widest = beam
        return np.minimum(narrow * np.sqrt(1 + ((r - focus) / reach) ** 2), widest)


class Blur:
    """Linear convolution of scatterers with the point spread at each depth."""

    def __init__(self, beams, spread):
        r, phi, theta = beams.axes
        a, b = beams.radii
        self.matrices = [
            _kernel(r[None], np.array([spread.axial]), 0.0)[0],
            _kernel((r + a)[:, None] * phi, spread.width(spread.lateral, r), spread.side_lobe),
            _kernel((r + b)[:, None] * theta, spread.width(spread.elevation, r), spread.side_lobe),
        ]

    def __call__(self, scatterers, first=0, last=None):
        """Echoes of complex scatterers in the samples from first to last; the others are zero."""
        axial, lateral, elevation = self.matrices
        rows = slice(first, last)
        axial, lateral, elevation = axial[rows, rows], lateral[rows], elevation[rows]
        count, lines, frames = scatterers[rows].shape
        both = np.stack([scatterers.real[rows], scatterers.imag[rows]]).astype(np.float32)
        both = (axial @ both.reshape(2, count, -1)).reshape(2, count, lines, frames)
        both = lateral @ both @ elevation.transpose(0, 2, 1)
        echoes = np.zeros(scatterers.shape, np.complex64)
        echoes.real[rows], echoes.imag[rows] = both
        return echoes


def _kernel(x, width, side_lobe):
    """(depths, n, n) matrices that blur along n positions, and keep the power of white noise."""
    ratio = (np.abs(x[:, :, None] - x[:, None]) / (width[:, None, None] / FWHM)).astype(np.float32)
    kernel = np.exp(-0.5 * ratio**2) + side_lobe * np.exp(-0.5 * (ratio / 3) ** 2)
    return kernel / np.sqrt((kernel**2).sum(axis=2, keepdims=True))


def splat(shape, index, amplitude, linear=3):
    """Complex scatterers on the grid from points at fractional (3, m) indices.

    A point is spread linearly along the first axes; along the others it goes to the nearest sample.
    """
    index = np.concatenate([index[:linear], np.round(index[linear:])])
    low = np.floor(index).astype(np.int64)
    part = (index - low).astype(np.float32)
    places, values = [], []
    for corner in np.ndindex((2,) * linear):
        at = low.copy()
        at[:linear] += np.array(corner)[:, None]
        weight = np.ones(low.shape[1], np.float32)
        for upper, share in zip(corner, part, strict=False):
            weight *= share if upper else 1 - share
        ok = np.all((at >= 0) & (at < np.array(shape)[:, None]), axis=0)
        places.append(np.ravel_multi_index(at[:, ok], shape))
        values.append((weight * amplitude)[ok])
    place, value = np.concatenate(places), np.concatenate(values)
    total = np.empty(shape, np.complex64)
    total.real = np.bincount(place, value.real, total.size).reshape(shape)
    total.imag = np.bincount(place, value.imag, total.size).reshape(shape)
    return total


def sample(array, index):
    """Values at fractional (3, ...) indices; that of the nearest sample outside the grid."""
    return map_coordinates(array, index, order=1, mode="nearest", prefilter=False)


@dataclass(frozen=True)
class Display:
    """Conversion of echoes to grey levels, in dB over the tissue's echo.

    The noise grows with depth by the gain that makes up for the attenuation.
    """

    dynamic_range: float
    tissue: float  # grey level of the tissue, as a share of the range
    noise: tuple[float, float]  # at the face and at full depth
    drift: float  # of the gain, from the face to full depth

    @staticmethod
    def draw(rng):
        shown, noise = (
            (rng.uniform(45, 75), rng.uniform(0.3, 0.55)),
            rng.uniform([-45, -25], [-30, -8]),
        )
        return Display(*shown, tuple(noise), rng.uniform(-5, 5))

    def noise_amplitude(self, samples):
        """(samples, 1, 1) standard deviation of the noise."""
        return 10 ** (np.linspace(*self.noise, samples)[:, None, None].astype(np.float32) / 20)

    def grey(self, echoes, rng):
        """Grey levels from 0 to 255, with noise, of complex echoes; tissue has unit power."""
        noise = rng.standard_normal((2, *echoes.shape), np.float32) / np.sqrt(np.float32(2))
        noisy = np.abs(
            echoes + self.noise_amplitude(len(echoes)) * (noise[0] + np.complex64(1j) * noise[1])
        )
        level = 20 * np.log10(noisy + np.float32(1e-6))
        level += np.linspace(0, self.drift, len(echoes), dtype=np.float32)[:, None, None]
        return np.clip(255 * (level / self.dynamic_range + self.tissue), 1, 255)


class Raster:
    """Cartesian grid centred under the face, and the beams' samples at its elements."""

    def __init__(self, beams, shape, spacing):
        self.spacing = np.asarray(spacing, float)
        self.origin = -0.5 * self.spacing * (np.array(shape) - 1)
        self.origin[1] = 0.0
        each = zip(self.origin, self.spacing, shape, strict=True)
        axes = [o + s * np.arange(n) for o, s, n in each]
        p_P = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        self.inside = beams.contains(p_P)
        self.index = beams.index(p_P[self.inside])

    def convert(self, grey):
        """Scan-convert grey levels; elements outside the beams are zero."""
        values = np.zeros(self.inside.shape, np.uint8)
        values[self.inside] = np.round(sample(grey, self.index)).astype(np.uint8)
        return values
