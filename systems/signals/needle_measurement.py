"""Measurement of the needle in one volume."""

from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable, Shape, seal
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.requirements import Fraction
from sonoservo.systems.signals.tissue_record import TissueRecord

_NOWHERE = seal(np.zeros((0, 3)))


@dataclass(frozen=True, eq=False)
class NeedleMeasurement(Immutable):
    """Needle found in one volume. If there is none, a `NotFound` takes its place."""

    curve: NeedleCurve
    """Curve of the needle in W, in m."""

    covariance: Annotated[NDArray[np.float64], Shape("3n", "3n")]
    """Covariance of the n stacked control points, in m^2. Tip and interior points are
    correlated."""

    time: float
    """Time at which the tip was acquired, in s."""

    inlier_count: int
    """Number of candidate voxels within the residual threshold."""

    inlier_ratio: Fraction
    """Their share of the candidates between entry and tip."""

    X_WP: RigidTransform | None = None
    """Pose of the probe from which the tip was seen; None if unknown."""

    tip_seen: Fraction = 1.0
    """Probability that the end of the curve is the tip."""

    elsewhere: Annotated[NDArray[np.float64], Shape(None, 3)] = field(
        default_factory=lambda: _NOWHERE
    )
    """Other places of the tip along the needle: probabilities, distances from the end of the curve
    and standard deviations, in m. The covariance is that of the first place alone."""

    common: Annotated[NDArray[np.float64], Shape("3n", "3n")] | None = None
    """Covariance of an error of the control points that all measurements have in common, in m^2;
    not part of the other one, and none if it is None."""

    unseen: Fraction = 0.0
    """Probability that a needle which goes on beyond the end is not seen there."""

    tissue: TissueRecord | None = None
    """Tissue along the needle where its tip has not been, this volume included; None if unknown."""

    def _extents(self) -> dict[str, int]:
        return {"n": self.curve.order}

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
        curve = NeedleCurve(z.reshape(-1, 3))
        return replace(self, curve=curve, covariance=R, tip_seen=1.0, elsewhere=_NOWHERE)

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
