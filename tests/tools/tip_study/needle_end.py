"""Distribution of the echoes of a needle near its tip, by where the tip is."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals import PointSpread, SweepGeometry
from sonoservo.systems.signals.sweep import blur_covariance

Floats = NDArray[np.float64]

INTERVAL = 5.0
"""Half the interval in which the tip may lie, in standard deviations of the blur."""

_BEYOND, _ASIDE = 3.0, 2.0
"""Distances beyond that interval, and from the axis, up to which samples count, in the same unit.
"""

_NEEDLE_STEP = 0.125
"""Distance between points of the needle, in standard deviations of the blur."""


@dataclass(frozen=True, kw_only=True)
class NeedleEnd:
    """Echo of a needle near its tip; levels are mean intensities on the axis over the tissue's."""

    shaft_db: float = 20.0
    """Level of the shaft's rough surface, whose points have random phases."""
    bevel_length: float = 0.0
    """Length over which the shaft's echo fades towards the tip, in m; 0 for a blunt tip."""
    mirror_db: float | None = None
    """Level of the mirror-like part, whose points are in phase, if it lay across the beam."""
    reverberation_db: float | None = None
    """Level of each echo inside the needle relative to the one before it; None for a solid one."""
    reverberation_distance: float = 0.9e-3
    """Distance between those echoes in m."""
    wavelength: float = 0.467e-3

    def echoes(self) -> list[tuple[complex, float]]:
        """Return the amplitude of each echo and its distance behind the first one, in m."""
        if self.reverberation_db is None:
            return [(1.0, 0.0)]
        ratio = _amplitude(self.reverberation_db)
        distances = self.reverberation_distance * np.arange(1.0 + int(-40 / self.reverberation_db))
        levels = ratio ** np.arange(len(distances)) * np.exp(-1j * self._phase(distances))
        return list(zip(levels.tolist(), distances.tolist(), strict=True))

    def mirror_phase(self, path: Floats) -> NDArray[np.complex128]:
        """Return the phase factors of echoes from (n,) depths along the beam, in m."""
        return np.asarray(np.exp(-1j * self._phase(path)))

    def _phase(self, path: NDArray[Any]) -> Floats:
        return np.asarray(4 * np.pi / self.wavelength * path)


class EndSamples(NamedTuple):
    """Samples of a sweep near a needle's end, in coordinates in which the blur is a unit sphere."""

    blur: float
    """Standard deviation of a point's echo on the axis, in m; the unit of length."""
    along: Floats
    """(n,) abscissae on the needle's axis from its tip."""
    across: Floats
    """(n, 2) offsets from the axis."""
    slope: float = 0.0
    """Sine of the angle between the needle and a plane across the beam, in space."""
    behind: Floats = np.zeros(3)
    """(3,) displacement along the axis, and across it, of a point 1 m further along the beam."""
    p_P: Floats = np.zeros((0, 3))
    """(n, 3) positions of the samples in P, in m."""


def samples_near(
    geometry: SweepGeometry, spread: PointSpread, p_PTip: Floats, direction: Floats
) -> EndSamples:
    """Return the samples of a sweep that show a needle's end.

    The point spread function is taken as that at the tip. In coordinates q = Sigma^(-1/2) p, with
    its covariance Sigma, it is exp(-|q|^2 / 2), and the needle is a line again, whose unit of
    length is the blur on the axis, 1 / sqrt(k^T Sigma^-1 k).
    """
    root = np.linalg.cholesky(np.linalg.inv(blur_covariance(spread, geometry, p_PTip[None])[0])).T
    k = root @ direction
    blur = float(1 / np.linalg.norm(k))
    far = INTERVAL + _BEYOND
    ends = p_PTip + blur * far * np.outer([-1.0, 1.0], direction)
    index = np.array(geometry.index(ends, 1))
    widest = 4 * _ASIDE * np.sqrt(np.trace(np.linalg.inv(root.T @ root)))
    radius = max(geometry.array_radius + p_PTip[1], 1e-3)
    frame_pitch = geometry.frame_pitch * (geometry.motor_radius + p_PTip[1])
    wide = widest / np.array([frame_pitch, geometry.line_pitch * radius, geometry.sample_pitch])
    first = np.maximum(index.min(axis=1) - wide, 0).astype(int)
    last = np.minimum(index.max(axis=1) + wide + 1, geometry.shape).astype(int)
    grid = [np.arange(*each) for each in zip(first, last, strict=True)]
    frame, middle, depth = (float(each) for each in geometry.index(p_PTip, 1))
    beam = geometry.position(frame, middle, depth + 1, 1) - p_PTip
    beam /= np.linalg.norm(beam)
    frames, lines, depths = np.meshgrid(*grid, indexing="ij")
    positions = geometry.position(frames, lines, depths, 1).reshape(-1, 3)
    axes = np.concatenate([k[np.newaxis] * blur, np.linalg.svd(k[np.newaxis])[2][1:]])
    along, *aside = axes @ root @ (positions - p_PTip).T
    across = np.transpose(aside)
    near = (np.abs(along) < far) & (np.linalg.norm(across, axis=1) < _ASIDE)
    order = np.argsort(along[near])
    slope, behind = float(beam @ direction), axes @ root @ beam
    positions = positions[near][order]
    return EndSamples(blur, along[near][order], across[near][order], slope, behind, positions)


class EchoModel(NamedTuple):
    """Distribution of the complex echoes of (n,) samples for each of (t,) tips."""

    mean: NDArray[np.complex128]
    """(t, n) means, up to a phase that they share."""
    root: NDArray[np.complex128]
    """(t, n, n) lower Cholesky factors of the covariances."""


def echo_model(end: NeedleEnd, samples: EndSamples, tips: Floats, noise_db: float) -> EchoModel:
    """Return the distribution of the echoes near a needle's end, for every place of its tip.

    Tissue, the needle's rough surface and noise are circular complex Gaussian fields. The tissue's
    covariance is exp(-|q - q'|^2 / 4). The needle's follows from the variance of its points, which
    ends at the tip, through the point spread function. Tips are in units of the blur, the noise is
    relative to the tissue.
    """
    blur, x, across = samples[:3]
    s = np.arange(x.min() - 5, x.max() + 5, _NEEDLE_STEP)
    seen = _response(end, samples, s)
    from_tip = tips[:, np.newaxis] - s
    length = end.bevel_length / blur
    present = np.clip(from_tip / _NEEDLE_STEP + 0.5, 0, 1) * _NEEDLE_STEP
    wall = np.clip(from_tip / length, 0, 1) if length else np.ones_like(from_tip)
    variance = (_amplitude(end.shaft_db) * wall) ** 2 * present / np.sqrt(np.pi)
    apart = np.sum((across[:, np.newaxis] - across) ** 2, axis=-1) + (x[:, np.newaxis] - x) ** 2
    covariance = (variance[:, np.newaxis] * seen) @ seen.conj().T + np.exp(-apart / 4)
    covariance += 10 ** (noise_db / 10) * np.eye(len(x))
    mirror = _amplitude(end.mirror_db) * wall * present / np.sqrt(2 * np.pi)
    mean = (mirror * end.mirror_phase(samples.slope * blur * s)) @ seen.T
    return EchoModel(mean, np.linalg.cholesky(covariance))


def _response(end: NeedleEnd, samples: EndSamples, s: Floats) -> NDArray[np.complex128]:
    """Return the (n, m) echoes in all samples of points of the axis at (m,) abscissae."""
    response = np.zeros((len(samples.along), len(s)), complex)
    for level, distance in end.echoes():
        along = samples.along - distance * samples.behind[0]
        across = samples.across - distance * samples.behind[1:]
        squared = (along[:, np.newaxis] - s) ** 2 + np.sum(across**2, axis=1)[:, np.newaxis]
        response += level * np.exp(-squared / 2)
    return response


def _amplitude(level_db: float | None) -> float:
    return 0.0 if level_db is None else float(10 ** (level_db / 20))
