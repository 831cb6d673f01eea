"""Distribution of the echoes of a needle near its tip, by where the tip is."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.blur import blur_covariance
from sonoservo.systems.signals.point_spread import PointSpread
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.sweep import SweepGeometry

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
    """Echo of a needle near its tip; levels are mean intensities on the axis over the tissue's.

    Parameters
    ----------
    shaft_db
        Level of the shaft's rough surface, whose points have random phases.
    bevel_length
        Length over which the shaft's echo fades towards the tip, in m; 0 for a blunt tip.
    bevel_db
        Level that the bevel's face would have if it were long; None if it does not echo.
    point_db
        Level of an echo of the tip itself, as of a point; None for none.
    mirror_db
        Level of the shaft's mirror-like part, whose points are in phase, if it lay across the
        beam; None for none.
    phase_rate
        Change of its phase along the needle in rad/m: 4 pi sin(dip) / wavelength.

    Raises
    ------
    ValueError
        If a length is negative.
    """

    shaft_db: float = 20.0
    bevel_length: float = 0.0
    bevel_db: float | None = None
    point_db: float | None = None
    mirror_db: float | None = None
    phase_rate: float = 0.0

    def __post_init__(self) -> None:
        require(self.bevel_length >= 0, "bevel_length", self.bevel_length, "at least 0 m")


class EndSamples(NamedTuple):
    """Samples of a sweep near a needle's end, in coordinates in which the blur is a unit sphere."""

    blur: float
    """Standard deviation of a point's echo on the axis, in m; the unit of length."""
    along: Floats
    """(n,) abscissae on the needle's axis from its tip."""
    across: Floats
    """(n, 2) offsets from the axis."""


def samples_near(
    geometry: SweepGeometry, spread: PointSpread, p_PTip: Floats, direction: Floats
) -> EndSamples:
    """Return the samples of a sweep that show a needle's end.

    The point spread function is taken as that at the tip. In coordinates q = Sigma^(-1/2) p, with
    its covariance Sigma, it is exp(-|q|^2 / 2), and the needle is a line again, whose unit of
    length is the blur on the axis, 1 / sqrt(k^T Sigma^-1 k).

    Parameters
    ----------
    geometry, spread
        Geometry of the sweep and widths of its point spread function.
    p_PTip, direction
        (3,) tip in P, in m, and (3,) unit vector k along the needle towards the tip.

    Raises
    ------
    ValueError
        If no sample is near the tip.
    """
    root = np.linalg.cholesky(np.linalg.inv(blur_covariance(spread, geometry, p_PTip[None])[0])).T
    k = root @ direction
    blur = float(1 / np.linalg.norm(k))
    far = INTERVAL + _BEYOND
    ends = p_PTip + blur * far * np.outer([-1.0, 1.0], direction)
    index = np.array(geometry.index(ends, 1))
    widest = 4 * _ASIDE * np.sqrt(np.trace(np.linalg.inv(root.T @ root)))
    radius = max(geometry.array_radius + p_PTip[1], 1e-3)
    pitches = (geometry.frame_pitch * (geometry.motor_radius + p_PTip[1]),
               geometry.line_pitch * radius, geometry.sample_pitch)  # fmt: skip
    grid = [
        np.arange(max(int(low - widest / pitch), 0), min(int(high + widest / pitch) + 1, count))
        for low, high, pitch, count in zip(
            index.min(axis=1), index.max(axis=1), pitches, geometry.shape, strict=True
        )
    ]
    frames, lines, depths = np.meshgrid(*grid, indexing="ij")
    positions = geometry.position(frames, lines, depths, 1).reshape(-1, 3)
    q = (positions - p_PTip) @ root.T
    along = q @ k * blur
    aside = np.linalg.svd(k[np.newaxis])[2][1:]
    across = q @ aside.T
    near = (np.abs(along) < far) & (np.linalg.norm(across, axis=1) < _ASIDE)
    require(bool(near.any()), "p_PTip", p_PTip, "in the swept sector")
    order = np.argsort(along[near])
    return EndSamples(blur, along[near][order], across[near][order])


class EchoModel(NamedTuple):
    """Distribution of the complex echoes of (n,) samples for each of (t,) tips."""

    mean: NDArray[np.complex128]
    """(t, n) means, up to a phase that they share."""
    root: Floats
    """(t, n, n) lower Cholesky factors of the covariances."""


def echo_model(end: NeedleEnd, samples: EndSamples, tips: Floats, noise_db: float) -> EchoModel:
    """Return the distribution of the echoes near a needle's end, for every place of its tip.

    Tissue, the needle's rough surface and noise are circular complex Gaussian fields. The tissue's
    covariance is exp(-|q - q'|^2 / 4). The needle's follows from the variance of its points, which
    ends at the tip, through the point spread function.

    Parameters
    ----------
    end
        Levels of the needle.
    samples
        Samples near its end.
    tips
        (t,) abscissae of the tip, in units of the blur.
    noise_db
        Level of the noise over the tissue's.
    """
    blur, x, across = samples
    aside = np.exp(-np.sum(across**2, axis=1) / 2)
    s = np.arange(x.min() - 5, x.max() + 5, _NEEDLE_STEP)
    seen = np.exp(-((x[:, np.newaxis] - s) ** 2) / 2) * aside[:, np.newaxis]
    from_tip = tips[:, np.newaxis] - s
    length = end.bevel_length / blur
    present = np.clip(from_tip / _NEEDLE_STEP + 0.5, 0, 1) * _NEEDLE_STEP
    wall = np.clip(from_tip / length, 0, 1) if length else np.ones_like(from_tip)
    rough = _amplitude(end.shaft_db) * wall + _amplitude(end.bevel_db) * (from_tip < length)
    variance = rough**2 * present / np.sqrt(np.pi)
    apart = np.sum((across[:, np.newaxis] - across) ** 2, axis=-1) + (x[:, np.newaxis] - x) ** 2
    covariance = (variance[:, np.newaxis] * seen) @ seen.T + np.exp(-apart / 4)
    covariance += 10 ** (noise_db / 10) * np.eye(len(x))
    point = _amplitude(end.point_db) * np.exp(-((x - tips[:, np.newaxis]) ** 2) / 2) * aside
    covariance += point[:, :, np.newaxis] * point[:, np.newaxis]
    mirror = _amplitude(end.mirror_db) * wall * present / np.sqrt(2 * np.pi)
    mean = (mirror * np.exp(1j * end.phase_rate * blur * s)) @ seen.T
    return EchoModel(mean, np.linalg.cholesky(covariance))


def _amplitude(level_db: float | None) -> float:
    return 0.0 if level_db is None else float(10 ** (level_db / 20))
