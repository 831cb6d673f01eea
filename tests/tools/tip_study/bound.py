"""Least error with which a needle's tip can be found along its axis in one volume."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0e

from sonoservo.systems.signals.point_spread import PointSpread
from sonoservo.systems.signals.sweep import SweepGeometry
from tip_study.needle_end import (
    INTERVAL,
    EchoModel,
    NeedleEnd,
    echo_model,
    samples_near,
)

Floats = NDArray[np.float64]

_COARSE, _FINE, _POSSIBLE = 21, 32, 14.0
"""Numbers of tips that are compared, on a coarse and on a fine grid, and logarithm of the ratio of
likelihoods beyond which a tip is impossible."""


def field_log_likelihood(model: EchoModel, echoes: NDArray[np.complex128]) -> Floats:
    """Return the (t,) logarithms of the likelihood of the tips, given (n,) complex echoes.

    The phase that the means share is unknown and uniformly distributed.
    """
    echo = np.broadcast_to(echoes, model.mean.shape)
    white, mean = (_solved(model.root, each) for each in (echo, model.mean))
    inner = 2 * np.abs(np.sum(white.conj() * mean, axis=1))
    energy = np.sum(np.abs(white) ** 2 + np.abs(mean) ** 2, axis=1)
    scale = 2 * np.log(np.diagonal(model.root, axis1=1, axis2=2).real).sum(axis=1)
    return np.asarray(np.log(i0e(inner)) + inner - energy - scale)


def _solved(root: NDArray[np.complex128], values: NDArray[np.complex128]) -> NDArray[np.complex128]:
    return np.asarray(np.linalg.solve(root, values[..., np.newaxis])[..., 0])


def envelope_log_likelihood(
    model: EchoModel, envelope: Floats, rng: np.random.Generator, particles: int = 50
) -> Floats:
    """Return the (t,) logarithms of the likelihood of the tips, given (n,) echo amplitudes.

    A particle filter along the needle integrates out the phases. Given the echoes before it, an
    echo z is Gaussian with a mean mu and a variance sigma^2, so its phase has a von Mises
    distribution of concentration 2 |z| |mu| / sigma^2. It is drawn from a wrapped Cauchy
    distribution of nearly the same shape (Best and Fisher 1979), and the particle weighted with
    the ratio of the densities. All tips share the random numbers, which are evenly spread, so that
    they disturb the ratios of likelihoods little. The likelihood is unbiased.
    """
    tips, n = model.mean.shape
    white = np.zeros((tips, n, particles), complex)
    weights = np.full((tips, particles), 1 / particles)
    total = np.zeros(tips)
    tiny = np.finfo(float).tiny
    even = np.arange(particles)
    for i, r in enumerate(envelope):
        sigma = model.root[:, i, i, np.newaxis].real
        mu = (model.root[:, np.newaxis, i, :i] @ white[:, :i])[:, 0] + model.mean[:, i, np.newaxis]
        expected = np.abs(mu)
        kappa = np.maximum(2 * r * expected / sigma**2, 1e-3)
        tau = 1 + np.sqrt(1 + 4 * kappa**2)
        rho = (tau - np.sqrt(2 * tau)) / (2 * kappa)
        u = (rng.permutation(particles) + rng.random()) / particles
        half = (1 - rho) / (1 + rho) * np.tan(np.pi * (u - 0.5))
        cosine = (1 - half**2) / (1 + half**2)
        turn = cosine + 2j * half / (1 + half**2)
        z = r * turn * np.where(expected > 0, mu / np.maximum(expected, tiny), 1)
        white[:, i] = (z - mu) / sigma
        density = (1 - rho**2) / (1 + rho**2 - 2 * rho * cosine)
        weights = weights * np.exp(-(np.abs(white[:, i]) ** 2)) / density
        sums = np.maximum(weights.sum(axis=1), tiny)
        total += np.log(2 * r / sigma[:, 0] ** 2 * sums)
        weights = weights / sums[:, np.newaxis]
        start = rng.random()
        few = np.flatnonzero(np.sum(weights**2, axis=1) > 2 / particles)
        if len(few) and i + 1 < n:
            edges = np.cumsum(weights[few], axis=1)
            at = (start + even) / particles
            chosen = np.sum(edges[:, np.newaxis] < at[:, np.newaxis], axis=2)
            chosen = np.minimum(chosen, particles - 1)[:, np.newaxis]
            white[few, : i + 1] = np.take_along_axis(white[few, : i + 1], chosen, axis=2)
            weights[few] = 1 / particles
    return total


class TipBound(NamedTuple):
    """Errors of the best estimators of a tip along its axis, over many volumes."""

    variances: Floats
    """(volumes,) variances of the tip given the amplitudes, in m^2."""
    field_variances: Floats
    """(volumes,) variances of the tip given the complex echoes, in m^2."""

    @property
    def std(self) -> float:
        """Least root mean square error of an estimator that knows the amplitudes, in m."""
        return float(np.sqrt(self.variances.mean()))

    @property
    def field_std(self) -> float:
        """Least root mean square error of an estimator that knows the phases, too, in m."""
        return float(np.sqrt(self.field_variances.mean()))


def tip_error_bound(
    end: NeedleEnd, geometry: SweepGeometry, spread: PointSpread, *, depth: float, dip_deg: float,
    noise_db: float, volumes: int, particles: int,
) -> TipBound:  # fmt: skip
    """Return the least error with which a needle's tip can be found along its axis in one volume.

    It is the mean variance of the tip given the volume, the minimum mean square error (Van Trees
    1968, section 2.4): no estimator, biased or not, has a smaller mean squared error over all tips
    in an interval of 10 standard deviations of the blur. The estimator is taken to know the axis,
    the blur, and all levels of needle, tissue and noise, and sees the samples as acquired, before
    they are rounded to grey levels and resampled. Volumes are drawn from the model of `echo_model`.

    The Cramer-Rao bound is far below it, except for a mirror-like end: the needle's own speckle
    makes the likelihood of a rough end ragged, however bright it is.
    """
    rng = np.random.default_rng(0)
    dip = np.deg2rad(dip_deg)
    direction = np.array([np.cos(dip), np.sin(dip), 0.0])
    middle = np.array([0.0, depth, 0.0])
    k, j, i = (float(each) for each in geometry.index(middle, 1))
    found = []
    for _ in range(volumes):
        # The tip lies anywhere between the samples.
        tip = geometry.position(k + rng.random(), j + rng.random(), i + rng.random(), 1)
        samples = samples_near(geometry, spread, tip, direction)
        true = rng.uniform(-INTERVAL, INTERVAL)
        model = echo_model(end, samples, np.array([true]), noise_db)
        noise = rng.normal(scale=np.sqrt(0.5), size=(2, len(samples.along)))
        echoes = model.mean[0] + model.root[0] @ (noise[0] + 1j * noise[1])
        models = partial(echo_model, end, samples, noise_db=noise_db)
        seen = {"envelope": np.abs(echoes), "rng": rng, "particles": particles}
        both = (
            partial(envelope_log_likelihood, **seen),
            partial(field_log_likelihood, echoes=echoes),
        )
        found.append([samples.blur**2 * _variance(models, each) for each in both])
    return TipBound(*np.transpose(found))


def _variance(
    models: Callable[[Floats], EchoModel], log_likelihood: Callable[[EchoModel], Floats]
) -> float:
    """Return the variance of the tip given a volume, in units of the blur.

    Tips are compared on a coarse grid first, then on a fine one between those that are possible.
    """
    coarse = np.linspace(-INTERVAL, INTERVAL, _COARSE)
    rough = log_likelihood(models(coarse))
    possible = coarse[rough > rough.max() - _POSSIBLE]
    step = coarse[1] - coarse[0]
    low, high = max(possible[0] - step, -INTERVAL), min(possible[-1] + step, INTERVAL)
    # The middles of equal parts of the interval.
    tips = low + (high - low) * (np.arange(_FINE) + 0.5) / _FINE
    fine = log_likelihood(models(tips))
    weights = np.exp(fine - fine.max())
    weights /= weights.sum()
    return float(weights @ (tips - weights @ tips) ** 2)
