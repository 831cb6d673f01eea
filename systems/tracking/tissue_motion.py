"""How tissue has moved: one belief about its displacements at the times of several volumes."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable

Floats = NDArray[np.float64]

_FIRST = 1e-6
"""Standard deviation in m of the displacement at the first volume, from which all others count."""


def _anchor() -> Floats:
    return np.eye(3)[np.newaxis, :, np.newaxis] / _FIRST**2


@dataclass(frozen=True, eq=False)
class TissueMotion(Immutable):
    """Joint Gaussian of the displacements of tissue at the times of n volumes.

    A comparison of two volumes tells how the one displacement differs from the other, so both move
    when a third volume says otherwise (Thrun and Montemerlo 2006).
    """

    information: Floats = field(default_factory=_anchor)
    """(n, 3, n, 3) information, in 1/m^2."""
    weighted: Floats = field(default_factory=lambda: np.zeros((1, 3)))
    """(n, 3) information times the mean, in 1/m."""

    @property
    def means(self) -> Floats:
        """(n, 3) displacements in m."""
        size = self.weighted.size
        flat = np.linalg.solve(self.information.reshape(size, size), self.weighted.ravel())
        return np.asarray(flat.reshape(-1, 3))

    def with_volume(
        self, rest: Floats, compared: Iterable[tuple[int, Floats, Floats]]
    ) -> "TissueMotion":
        """Return the belief about one more volume.

        Parameters
        ----------
        rest
            (3, 3) information that its displacement is zero.
        compared
            Numbers of other volumes, (3,) differences in m from their displacements, and (3, 3)
            information about these.
        """
        n = len(self.weighted)
        information = np.zeros((n + 1, 3, n + 1, 3))
        information[:n, :, :n] = self.information
        information[n, :, n] = rest
        weighted = np.concatenate([self.weighted, np.zeros((1, 3))])
        for number, difference, told in compared:
            for a in (number, n):
                for b in (number, n):
                    information[a, :, b] += told if a == b else -told
            weighted[n] += told @ difference
            weighted[number] -= told @ difference
        return TissueMotion(information, weighted)

    def without(self, number: int) -> "TissueMotion":
        """Return the belief about all volumes but one, with what that one tells about them."""
        others = np.delete(np.arange(len(self.weighted)), number)
        across = self.information[others][:, :, number]
        gain = across @ np.linalg.inv(self.information[number, :, number])
        kept = self.information[others][:, :, others]
        return TissueMotion(
            kept - np.einsum("iab,jcb->iajc", gain, across),
            self.weighted[others] - gain @ self.weighted[number],
        )
