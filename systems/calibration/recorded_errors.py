"""Errors of the poses of recorded volumes, with a doubt that counts the places of the probe.

Whatever is odd about a place of the probe, such as how far it presses the tissue in, is in every
pair of volumes that shares it. A fit to pairs from few places follows it, and leaves small
residuals. So each place is left out in turn, to see how far the estimate then goes (a jackknife).
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from scipy.stats import t as student

from sonoservo.systems.calibration.pose_errors import (
    _LEAST,
    _MOST,
    _OUTLYING,
    _PAIRS,
    _PRIOR,
    _ROTATION,
    _TRANSLATION,
    _TYPICAL,
    _VOLUMES,
    PoseEquations,
    PoseErrors,
    displacement_between,
    estimate_pose_errors,
    pose_equations,
)
from sonoservo.systems.signals.confidence import squared_distance
from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

_PLAUSIBLE = 0.999  # share of the errors that can be expected beyond which the tissue's are blamed


@dataclass(frozen=True, eq=False)
class PlacedPair(Immutable):
    """Equations of a pair of volumes, and the numbers of the two places of the probe."""

    places: tuple[int, int]
    equations: PoseEquations


@dataclass(frozen=True, eq=False)
class RecordedCalibration(Immutable):
    """The newest volumes with the numbers of their places, all places, and pairs of volumes.

    Pairs are chosen as by `PoseCalibration`. Poses too close to be compared are one place.
    """

    volumes: tuple[tuple[int, Volume], ...] = ()
    places: tuple[RigidTransform, ...] = ()
    pairs: tuple[PlacedPair, ...] = ()

    @cached_property
    def errors(self) -> PoseErrors | NotFound:
        """Errors of the poses, or a `NotFound` with the reason why they are unknown."""
        if not self.pairs:
            return NotFound("no two volumes show the same tissue from different poses")
        found = estimate_pose_errors([each.equations for each in self.pairs])
        return found if isinstance(found, NotFound) else with_doubt(found, self.pairs)

    def seen(self, volume: Volume) -> "RecordedCalibration":
        """Return the calibration after one more volume, compared with the one that tells most."""
        places = self.places
        apart = [_motion(each, volume.X_WP) for each in places]
        if min(apart, default=math.inf) < _LEAST:
            place = apart.index(min(apart))
        else:
            place, places = len(places), (*places, volume.X_WP)
        known = replace(self, volumes=(*self.volumes, (place, volume))[-_VOLUMES:], places=places)
        motions = [_motion(earlier.X_WP, volume.X_WP) for _, earlier in self.volumes]
        near = [
            (abs(math.log(motion)), other, earlier)
            for motion, (other, earlier) in zip(motions, self.volumes, strict=True)
            if other != place and _LEAST <= motion <= _MOST
        ]
        if not near:
            return known
        _, other, earlier = min(near, key=lambda each: each[0])
        tissue = displacement_between(earlier, volume)
        if not len(tissue.p_W):
            return known
        pair = PlacedPair((other, place), pose_equations(earlier, volume, tissue))
        return replace(known, pairs=(*self.pairs, pair)[-_PAIRS:])


def with_doubt(errors: PoseErrors, pairs: tuple[PlacedPair, ...]) -> PoseErrors | NotFound:
    """Return errors with the covariance that the places tell; `NotFound` if they are too few.

    Twice its standard deviations are 95 %, by Student's distribution where places are few.
    """
    x = np.array([errors.delay, *errors.translation, *errors.rotation]) / _PRIOR
    expected = _TYPICAL**2 * sum(len(each.equations.displacement) for each in pairs) / len(pairs)
    informations, scores = zip(*(_fit(each.equations, x) for each in pairs), strict=True)
    told = np.sum(informations, axis=0)
    information = told + expected * np.eye(7)
    inverse = np.linalg.inv(information)
    unknowns = float(np.trace(inverse @ told))
    places = sorted({place for each in pairs for place in each.places})
    freedom = len(places) - 1 - unknowns
    if freedom < 1:
        return _untold(len(places))
    if x @ x > squared_distance(_PLAUSIBLE, len(x)):
        return NotFound(
            "they cannot be told from these volumes: the tissue seems to move as if they were far "
            "larger than can be expected; it must stand still, and the probe press it evenly"
        )
    shifts = []
    for place in places:
        out = [k for k, each in enumerate(pairs) if place in each.places]
        left = information - np.sum([informations[k] for k in out], axis=0)
        shifts.append(np.linalg.solve(left, np.sum([scores[k] for k in out], axis=0)))
    spread = (len(places) - 1) / len(places) * np.einsum("pi,pj->ij", shifts, shifts)
    wide = float(student.ppf(0.975, freedom)) / 2
    covariance = wide**2 * spread + expected**2 * inverse @ inverse
    found = replace(errors, covariance=_PRIOR[:, np.newaxis] * covariance * _PRIOR)
    return found if are_told(found).any() else _untold(len(places))


def are_told(errors: PoseErrors) -> NDArray[np.bool_]:
    """Return (7,) flags of what volumes tell better than what can be expected without them."""
    return np.asarray(errors.std < _PRIOR / math.sqrt(2))


def _untold(places: int) -> NotFound:
    return NotFound(
        f"they cannot be told from these volumes: the probe was in only {places} places; move and "
        "turn it more"
    )


def _fit(equations: PoseEquations, x: Floats) -> tuple[Floats, Floats]:
    """Return the information and the score of a pair's equations, weighed as at x."""
    A = equations.matrix * _PRIOR
    off = equations.displacement - A @ x
    weighed = A.T / np.sqrt(1 + (off / _OUTLYING) ** 2)
    return weighed @ A, weighed @ off


def _motion(first: RigidTransform, second: RigidTransform) -> float:
    """Return the motion between two poses, relative to that which tells most."""
    X = first.InvertAndCompose(second)
    moved = math.hypot(*X.translation()) / _TRANSLATION
    return math.hypot(moved, X.rotation().ToAngleAxis().angle() / _ROTATION)
