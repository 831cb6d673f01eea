"""From whatever numbers a file holds to the grey levels that trackers take."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.requirements import require

_ALMOST_ALL = 0.999
"""Share of the voxels in the field of view above which a much greater number is an outlier."""


@dataclass(frozen=True)
class GreyWindow(Immutable):
    """The range of a file's numbers that becomes the grey levels 0 to 255; beyond it they saturate.

    Parameters
    ----------
    low, high
        That become 0 and 255.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        finite = bool(np.isfinite([self.low, self.high]).all())
        require(finite and self.low < self.high, "window", (self.low, self.high), "two rising ends")

    def grey(self, voxels: NDArray[Any]) -> NDArray[Any]:
        """Return grey levels in C order: uint8 as it is if the window is 0 to 255, else float32."""
        if voxels.dtype == np.uint8 and (self.low, self.high) == (0, 255):
            return np.ascontiguousarray(voxels)
        levels = np.array(voxels, np.float32, order="C")
        if (self.low, self.high) != (0, 255):
            levels -= np.float32(self.low)
            levels *= np.float32(255 / (self.high - self.low))
        return np.clip(levels, 0, 255, out=levels)


def choose_window(voxels: NDArray[Any]) -> GreyWindow:
    """Choose a window for volumes like this one; it must then stay the same for all of them.

    8-bit grey levels are taken as they are. So are other numbers that look like such: from 0 to at
    most 255, with more than half of that range in use; from 0 to at most 1 likewise, times 255.
    Otherwise the least number, which also fills what lies outside the field of view, becomes 0, and
    the greatest becomes 255, unless it is an outlier: then the 99.9 % quantile does. The numbers
    should be log-compressed: for linear amplitudes take the logarithm first.
    """
    if voxels.dtype == np.uint8:
        return GreyWindow(0, 255)
    low, high = float(voxels.min()), float(voxels.max())
    for full in (1, 255):
        if low >= 0 and 0.5 * full < high <= full and (full > 1 or voxels.dtype.kind == "f"):
            return GreyWindow(0, full)
    above = voxels[voxels > low]
    if above.size == 0:
        return GreyWindow(low, low + 1.0)
    most = float(np.quantile(above, _ALMOST_ALL, method="higher"))
    return GreyWindow(low, high if high - low < 2 * (most - low) else most)
