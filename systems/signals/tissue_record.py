"""Record of the tissue along a needle's axis, from before the needle came."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, Shape
from sonoservo.systems.signals.requirements import Positive

Floats = NDArray[np.float64]
Samples = Annotated[Floats, Shape("m")]

_REMEMBERED = 8
"""Number of looks that are remembered: the probe moves, and the axis is found anew each time."""


@dataclass(frozen=True, eq=False)
class TissueRecord(Immutable):
    """Contrast of the tissue along a needle's axis where its tip has not been.

    The record goes with the needle: places are told by their distance from its entry.
    """

    step: Positive
    """Distance between samples in m; the first one is at the entry."""

    contrast: Samples
    """Mean contrast in dB of the looks at each place; older ones count less and less."""

    looks: Samples
    """Number of the looks that are remembered there."""

    @classmethod
    def unseen(cls, step: float) -> "TissueRecord":
        """Return a record without a look, of samples that are ``step`` in m apart."""
        return cls(step, np.zeros(0), np.zeros(0))

    def at(self, distance: Floats) -> tuple[Floats, Floats]:
        """Return mean contrast and number of looks at (n,) distances from the entry in m."""
        if len(self.looks) == 0:
            return np.zeros(len(distance)), np.zeros(len(distance))
        known = self.step * np.arange(len(self.looks))
        looks = np.interp(distance, known, self.looks, left=0.0, right=0.0)
        return np.interp(distance, known, self.contrast), looks

    def seen(
        self,
        distance: Floats,
        contrast: Floats,
        ahead: NDArray[np.bool_],
        as_before: float = 1.0,
    ) -> "TissueRecord":
        """Return the record after a look at (n,) distances from the entry in m.

        The contrast in dB counts where ``ahead`` flags that the needle has not been, and the looks
        before by the probability ``as_before`` that the tissue has not moved since.
        """
        samples = max(len(self.looks), int(distance[-1] / self.step) + 1)
        known = self.step * np.arange(samples)
        looks, mean = np.zeros(samples), np.zeros(samples)
        looks[: len(self.looks)] = as_before * self.looks
        mean[: len(self.looks)] = self.contrast
        now = np.interp(known, distance, contrast)
        looked = np.interp(known, distance, ahead, left=0.0, right=0.0) == 1
        looks[looked] = np.minimum(looks[looked] + 1, _REMEMBERED)
        mean[looked] += (now[looked] - mean[looked]) / looks[looked]
        return TissueRecord(self.step, mean, looks)
