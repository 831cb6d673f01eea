"""Delay of the probe's poses, and error of its hand-eye calibration, from tissue that stands still.

A pose that is right puts a piece of tissue at the same place in W whenever it is seen. If poses are
late by tau, and the image is not where the calibration puts it, the true pose is
X_true = X exp(tau V) exp(xi), with the pose X that a volume carries, the probe's velocity V in P
and a small displacement xi = (r, s) of the image in P. To first order, tissue at q in P then seems
to be at p' = p - R (s + r x q + tau (v + omega x q)). Its apparent motion between two volumes is
linear in the seven unknowns.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import t as student

from sonoservo.systems.files.counting import counted
from sonoservo.systems.shape.normalized_cross_correlation import Match, best_match
from sonoservo.systems.signals.confidence import squared_distance
from sonoservo.systems.signals.immutable import Immutable, NotFound, Shape, Vector3
from sonoservo.systems.signals.sweep import SweepMotion
from sonoservo.systems.signals.volume import Volume, acquired_from

Floats = NDArray[np.float64]

# Distance between the samples of a block in m, its edge length in samples, and the largest
# displacement that is looked for, in samples.
_PITCH, _KERNEL, _REACH = 0.7e-3, 15, 6
_APART = 14e-3  # Distance between the centres of neighbouring blocks, in m
_SEEN = 0.98  # Share of a search region that must be seen
_LEAST_CORRELATION = 0.5  # Correlation below which a block counts as changed


@dataclass(frozen=True, eq=False)
class TissueDisplacement(Immutable):
    """(m, 3) centres of blocks in W by the first volume, and displacements in the second, in m."""

    p_W: Annotated[Floats, Shape(None, 3)]
    displacement: Annotated[Floats, Shape(None, 3)]


def displacement_between(first: Volume, second: Volume) -> TissueDisplacement:
    """Measure how far tissue seems to have moved in W between two volumes that overlap there."""
    half, axes = _KERNEL // 2, first.X_WP.rotation().matrix()
    p_W = first.to_world(_centres(first))[0]
    p_W = p_W[_is_seen(first, p_W, axes, half) & _is_seen(second, p_W, axes, half + _REACH)]
    centres, displacements = [], []
    for centre in p_W:
        kernel = _block(first, centre, axes, half)
        region = _block(second, centre, axes, half + _REACH)
        if min(np.mean(kernel > 0), np.mean(region > 0)) < _SEEN:
            continue
        match = best_match(region, kernel)
        if not isinstance(match, Match) or match.at_border.any():
            continue
        if match.correlation >= _LEAST_CORRELATION:
            centres.append(centre)
            displacements.append(axes @ (_PITCH * (match.position - _REACH)))
    return TissueDisplacement(np.reshape(centres, (-1, 3)), np.reshape(displacements, (-1, 3)))


def _centres(volume: Volume) -> Floats:
    """Return (n, 3) centres of blocks in P, in m."""
    margin = _PITCH * (_KERNEL // 2)
    low, high = volume.origin + margin, volume.upper - margin
    lines = [np.arange(a, b, _APART) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)


def _is_seen(volume: Volume, p_W: Floats, axes: Floats, half: int) -> NDArray[np.bool_]:
    """Return (m,) flags of the positions in W around which the corners of a block are seen."""
    corners = np.stack(np.meshgrid(*3 * [[-1, 1]], indexing="ij"), axis=-1).reshape(-1, 3)
    points = p_W[:, np.newaxis] + _PITCH * half * corners @ axes.T
    seen = volume.sees(acquired_from(volume, points.reshape(-1, 3)))
    return np.asarray(seen.reshape(-1, len(corners)).all(axis=1))


def _block(volume: Volume, p_W: Floats, axes: Floats, half: int) -> NDArray[np.float32]:
    """Return the levels on a lattice around a point in W."""
    steps = _PITCH * np.arange(-half, half + 1)
    lattice = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1)
    ends = acquired_from(volume, p_W + np.array([[0.0, 0.0, 0.0], *axes.T]))
    # Within a block, the motion of the probe during the sweep is an affine map.
    return volume.sample(ends[0] + lattice @ (ends[1:] - ends[0]))


# Typical error of a block's displacement in m, and the error from which a block counts less: it
# holds the needle, or what it moves.
_TYPICAL, _OUTLYING = 0.1e-3, 0.3e-3
# Median distance in m by which blocks are off, with corrected poses, if tissue stands still. It
# was 0.2 mm in runs in which it did, and 2.4 to 2.8 mm with 5 mm of breathing.
_STILL = 0.6e-3
# Standard deviations of the expected errors: delay in s, translation in m and rotation in rad.
# They matter where the probe's motion tells little.
_PRIOR = np.array([0.2, 3e-3, 3e-3, 3e-3, 0.03, 0.03, 0.03])
_DEGREE = 3  # Degree of the polynomial through the poses of a sweep
_LEAST_PAIRS = 8  # Number of pairs of volumes without which nothing is said
_PLAUSIBLE = 0.999  # Share of the errors that can be expected beyond which the tissue's are blamed


@dataclass(frozen=True, eq=False)
class PoseErrors(Immutable):
    """Errors of the poses that volumes carry."""

    delay: float
    """Time in s by which the poses are late: the pose of a volume was true that much earlier."""
    translation: Vector3
    """Displacement in m of the image in the assumed probe frame P."""
    rotation: Vector3
    """Rotation vector in rad of the image in P."""
    covariance: Annotated[Floats, Shape(7, 7)]
    """Covariance of delay, translation and rotation, by the places in which the probe was."""
    places: int
    pairs: int
    blocks: int
    """Number of blocks of tissue compared in all ``pairs`` of volumes."""

    @property
    def std(self) -> Floats:
        """(7,) standard deviations of delay, translation and rotation."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def told(self) -> NDArray[np.bool_]:
        """(7,) flags of what the volumes tell better than what can be expected without them."""
        return np.asarray(self.std < _PRIOR / math.sqrt(2))

    @property
    def X_PI(self) -> RigidTransform:
        """Pose of the image I in the assumed probe frame P."""
        turn = Rotation.from_rotvec(self.rotation.copy()).as_matrix()
        return RigidTransform(RotationMatrix(turn), self.translation)

    def corrected(self, volume: Volume) -> Volume:
        """Return a volume with the true poses; the delay is corrected only with frame times."""
        if volume.motion is None:
            return replace(volume, X_WP=volume.X_WP.multiply(self.X_PI))
        motion = volume.motion
        velocities = probe_velocities(motion, np.append(motion.times, volume.time))
        turned, moved = (self.delay * each for each in velocities)
        later = np.tile(np.eye(4), (len(turned), 1, 1))
        later[:, :3, :3] = Rotation.from_rotvec(turned).as_matrix()
        later[:, :3, 3] = moved
        poses = np.concatenate([motion.X_WP, [volume.X_WP.GetAsMatrix4()]])
        *frames, middle = poses @ later @ self.X_PI.GetAsMatrix4()
        motion = replace(motion, X_WP=np.array(frames))
        return replace(volume, X_WP=RigidTransform(middle), motion=motion)


@dataclass(frozen=True, eq=False)
class PoseEquations(Immutable):
    """(3 m, 7) coefficients and (3 m,) apparent displacements in m of one pair of volumes."""

    matrix: Annotated[Floats, Shape("m", 7)]
    displacement: Annotated[Floats, Shape("m")]
    places: tuple[int, int]
    """Numbers of the two places of the probe."""


def probe_velocities(motion: SweepMotion, times: Floats) -> tuple[Floats, Floats]:
    """Return (m, 3) angular and translational velocities of P in P, in rad/s and m/s, at times."""
    if np.ptp(motion.times) == 0:
        return np.zeros((len(times), 3)), np.zeros((len(times), 3))
    middle = RigidTransform(motion.X_WP[len(motion.X_WP) // 2])
    poses = [middle.InvertAndCompose(RigidTransform(each)) for each in motion.X_WP]
    turned = Rotation.from_matrix([X.rotation().matrix() for X in poses]).as_rotvec()
    moved = np.array([X.translation() for X in poses])
    degree = min(_DEGREE, len(poses) - 1)
    fits = polynomial.polyfit(motion.times - motion.time, np.hstack([turned, moved]), degree)
    rates = polynomial.polyval(times - motion.time, polynomial.polyder(fits)).T
    return np.asarray(rates[:, :3]), np.asarray(rates[:, 3:])


def pose_equations(
    first: Volume, second: Volume, seen: TissueDisplacement, places: tuple[int, int]
) -> PoseEquations:
    """Return the equations from the apparent displacement of tissue between two volumes.

    ``places`` are the numbers of the probe's places in both.
    """
    here, there = (
        _coefficients(volume, p_W)
        for volume, p_W in ((first, seen.p_W), (second, seen.p_W + seen.displacement))
    )
    return PoseEquations((here - there).reshape(-1, 7), seen.displacement.ravel(), places)


def _coefficients(volume: Volume, p_W: Floats) -> Floats:
    """Return the (m, 3, 7) shifts of tissue against the truth, by unit of each unknown, negated."""
    R = volume.X_WP.rotation().matrix()
    p_P = acquired_from(volume, p_W)
    shifts = np.zeros((len(p_P), 3, 7))
    if volume.motion is not None:
        omega, v = probe_velocities(volume.motion, volume.to_world(p_P)[1])
        shifts[:, :, 0] = v + np.cross(omega, p_P)
    shifts[:, :, 1:4] = np.eye(3)
    for i, axis in enumerate(np.eye(3)):
        shifts[:, :, 4 + i] = np.cross(axis, p_P)
    return np.einsum("ij,mjk->mik", R, shifts)


def estimate_pose_errors(equations: Sequence[PoseEquations]) -> PoseErrors | NotFound:
    """Solve the equations of several pairs of volumes by robust least squares.

    Parameters
    ----------
    equations
        Equations of each pair of volumes; see `pose_equations`.

    Returns
    -------
    The errors, or a `NotFound` if there are too few pairs, or the tissue moves.

    Whatever is odd about a place of the probe, such as how far it presses the tissue in, is in
    every pair of volumes that shares it. A fit to pairs from few places follows it, and leaves
    small residuals. For the covariance, each place is therefore left out in turn, to see how far
    the estimate then goes (a jackknife). Twice its standard deviations are 95 %, by Student's
    distribution where places are few.
    """
    used = [each for each in equations if len(each.displacement)]
    if len(used) < _LEAST_PAIRS:
        return NotFound(f"{counted(len(used), 'pair')} of volumes with tissue in common: too few")
    A = np.concatenate([each.matrix for each in used]) * _PRIOR
    d = np.concatenate([each.displacement for each in used])

    # What can be expected counts as one pair.
    expected = _TYPICAL * np.sqrt(len(d) / len(used)) * np.eye(7)

    def residuals(x: Floats) -> Floats:
        return np.concatenate([A @ x - d, expected @ x])

    solution = least_squares(
        residuals, np.zeros(7), lambda _: np.vstack([A, expected]),
        loss="soft_l1", f_scale=_OUTLYING,
    )  # fmt: skip
    x = solution.x
    off = float(np.median(np.linalg.norm((A @ x - d).reshape(-1, 3), axis=1)))
    if off > _STILL:
        return NotFound(f"the tissue moves: half of it is off by more than {1e3 * off:.1f} mm")
    places = {place for each in used for place in each.places}
    relative = _covariance(used, places, x, float(expected[0, 0]) ** 2)
    covariance = _PRIOR[:, np.newaxis] * relative * _PRIOR
    delay, *rest = (_PRIOR * x).tolist()
    return PoseErrors(delay, rest[:3], rest[3:], covariance, len(places), len(used), len(d) // 3)


def _covariance(
    used: Sequence[PoseEquations], places: set[int], x: Floats, expected: float
) -> Floats:
    """Return the covariance of the errors x, relative to those that can be expected.

    ``expected`` is the information that these are, for the equations as they are.
    """
    informations, scores = zip(*(_fit(each, x) for each in used), strict=True)
    told = np.sum(informations, axis=0)
    inverse = np.linalg.inv(told + expected * np.eye(7))
    freedom = len(places) - 1 - float(np.trace(inverse @ told))
    if freedom < 1:
        return np.eye(7)
    shifts = []
    for place in places:
        out = [k for k, each in enumerate(used) if place in each.places]
        left = told + expected * np.eye(7) - np.sum([informations[k] for k in out], axis=0)
        shifts.append(np.linalg.solve(left, np.sum([scores[k] for k in out], axis=0)))
    spread = (len(places) - 1) / len(places) * np.einsum("pi,pj->ij", shifts, shifts)
    wide = float(student.ppf(0.975, freedom)) / 2
    return np.asarray(wide**2 * spread + expected**2 * inverse @ inverse)


def _fit(equations: PoseEquations, x: Floats) -> tuple[Floats, Floats]:
    """Return the information and the score of a pair's equations, weighed as at x."""
    A = equations.matrix * _PRIOR
    off = equations.displacement - A @ x
    weighed = A.T / np.sqrt(1 + (off / _OUTLYING) ** 2)
    return weighed @ A, weighed @ off


def told_errors(errors: PoseErrors | NotFound) -> PoseErrors | NotFound:
    """Return errors if the volumes tell any of them, or a `NotFound` with what to change."""
    if isinstance(errors, NotFound):
        return errors
    x = np.array([errors.delay, *errors.translation, *errors.rotation]) / _PRIOR
    if x @ x > squared_distance(_PLAUSIBLE, len(x)):
        why = (
            "the tissue seems to move as if the errors were far larger than can be expected; it "
            "must stand still, and the probe press it evenly"
        )
    elif not errors.told.any():
        why = f"the probe was in only {errors.places} places; move and turn it more"
    else:
        return errors
    return NotFound(why)


_VOLUMES, _PAIRS = 12, 60  # Largest numbers of earlier volumes and of pairs that are kept
# Motion between two volumes in m and rad that tells most. After more of it, the speckle has
# changed; after less, the errors hardly show.
_TRANSLATION, _ROTATION = 3e-3, math.radians(4.0)
# Smallest and largest motion between two volumes that are compared, relative to those.
_LEAST, _MOST = 0.1, 2.0


@dataclass(frozen=True, eq=False)
class PoseCalibration(Immutable):
    """The newest volumes, and the equations of pairs that tell the errors of their poses."""

    volumes: tuple[tuple[int, Volume], ...] = ()
    """Each with the number of its place."""
    places: Mapping[int, RigidTransform] = field(default_factory=dict)
    """Poses of the probe by number; those too close to be compared are one place."""
    equations: tuple[PoseEquations, ...] = ()

    @cached_property
    def errors(self) -> PoseErrors | NotFound:
        """Errors of the poses, or a `NotFound` with the reason why they are unknown."""
        if not self.equations:
            return NotFound("no two volumes show the same tissue from different poses")
        return estimate_pose_errors(self.equations)

    def seen(self, volume: Volume) -> "PoseCalibration":
        """Return the calibration after one more volume, compared with the one that tells most."""
        apart = {number: _motion(X, volume.X_WP) for number, X in self.places.items()}
        place = min(apart, key=lambda number: apart[number], default=-1)
        places = dict(self.places)
        if place < 0 or apart[place] >= _LEAST:
            place = max(places, default=-1) + 1
            places[place] = volume.X_WP
        known = PoseCalibration(
            (*self.volumes, (place, volume))[-_VOLUMES:],
            dict(list(places.items())[-_PAIRS:]),
            self.equations,
        )
        near = [
            (abs(math.log(moved)), number, each)
            for number, each in self.volumes
            if _LEAST <= (moved := _motion(each.X_WP, volume.X_WP)) <= _MOST
        ]
        if not near:
            return known
        _, other, earlier = min(near, key=lambda each: each[0])
        tissue = displacement_between(earlier, volume)
        if not len(tissue.p_W):
            return known
        pair = pose_equations(earlier, volume, tissue, (other, place))
        return replace(known, equations=(*self.equations, pair)[-_PAIRS:])


def _motion(first: RigidTransform, second: RigidTransform) -> float:
    """Return the motion between two poses, relative to that which tells most."""
    X = first.InvertAndCompose(second)
    moved = math.hypot(*X.translation()) / _TRANSLATION
    return math.hypot(moved, X.rotation().ToAngleAxis().angle() / _ROTATION)
