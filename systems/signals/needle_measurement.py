"""Measurement of the needle in one volume."""

from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable, read_only
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.requirements import check_bounds, within


@dataclass(frozen=True, eq=False)
class NeedleMeasurement(Immutable):
    """Needle found in one volume. If there is none, a `NotFound` takes its place.

    Parameters
    ----------
    curve
        Curve of the needle in W, in m.
    covariance
        (3n, 3n) covariance of the stacked control points, in m^2. Tip and interior points are
        correlated.
    time
        Time at which the tip was acquired, in s.
    inlier_count, inlier_ratio
        Number of candidate voxels within the residual threshold, and their share of the candidates
        between entry and tip.
    X_WP
        Pose of the probe from which the tip was seen; None if unknown.
    tip_seen
        Probability that the end of the curve is the tip.
    elsewhere
        (c, 3) other places of the tip along the needle: probabilities, distances from the end of
        the curve and standard deviations, in m. The covariance is that of the first place alone.
    bevel_std
        Standard deviation along the needle, in m, of an error of the tip that all measurements have
        in common, as the bevel is turned as it is; not part of the covariance.
    unseen
        Probability that a needle which goes on beyond the end is not seen there.
    """

    curve: NeedleCurve
    covariance: NDArray[np.float64]
    time: float
    inlier_count: int
    inlier_ratio: Annotated[float, within(0, 1)]
    X_WP: RigidTransform | None = None
    tip_seen: Annotated[float, within(0, 1)] = 1.0
    elsewhere: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    bevel_std: float = 0.0
    unseen: Annotated[float, within(0, 1)] = 0.0

    def __post_init__(self) -> None:
        size = 3 * self.curve.order
        object.__setattr__(
            self, "covariance", read_only(self.covariance, "covariance", (size, size))
        )
        shape = len(self.elsewhere), 3
        object.__setattr__(self, "elsewhere", read_only(self.elsewhere, "elsewhere", shape))
        check_bounds(self)

    @property
    def places(self) -> list[tuple[float, NDArray[np.float64], NDArray[np.float64]]]:
        """Probabilities, (3n,) stacked control points in m and their covariances in m^2, by place.

        The first place is that of the curve. Interior points move with the tip.
        """
        points, along = self.curve.control_points.ravel(), self._along
        found = [(self.tip_seen, points, self.covariance)]
        for probability, away, std in self.elsewhere:
            wider = self.covariance + std**2 * np.outer(along, along)
            found.append((probability, points + away * along, wider))
        return found

    def given(self, points: NDArray[np.float64], P: NDArray[np.float64]) -> "NeedleMeasurement":
        """Return the measurement at the place of the tip that a prediction makes most probable.

        ``points`` are the (3n,) predicted control points in m, and P their covariance in m^2.
        """
        fits, places = [], self.places
        for probability, z, R in places:
            y, S = z - points, P + R
            fit = -0.5 * (y @ np.linalg.solve(S, y) + np.linalg.slogdet(S)[1])
            fits.append(fit + np.log(max(probability, 1e-300)))
        _, z, R = places[int(np.argmax(fits))]
        return replace(
            self,
            curve=NeedleCurve(z.reshape(-1, 3)),
            covariance=R,
            tip_seen=1.0,
            elsewhere=np.zeros((0, 3)),
        )

    @property
    def total_covariance(self) -> NDArray[np.float64]:
        """(3n, 3n) covariance of the stacked control points over all places of the tip, in m^2."""
        total = self.tip_seen + self.elsewhere[:, 0].sum()
        wider = self.elsewhere[:, 0] @ (self.elsewhere[:, 1:] ** 2).sum(axis=1) / total
        return np.asarray(self.covariance + wider * np.outer(self._along, self._along))

    @property
    def _along(self) -> NDArray[np.float64]:
        """(3n,) displacements of the control points for 1 m of the tip along the needle."""
        return np.asarray(np.kron(np.linspace(0, 1, self.curve.order), self.curve.direction))
