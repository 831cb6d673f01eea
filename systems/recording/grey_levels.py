"""Conversion of a file's numbers to grey levels."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.requirements import require

_ALMOST_ALL = 0.999
"""Quantile of the numbers in the field of view that replaces a maximum far above it."""


@dataclass(frozen=True)
class GreyWindow(Immutable):
    """Range of a file's numbers that becomes the grey levels 0 to 255; numbers beyond it saturate.

    Parameters
    ----------
    low, high
        Numbers that become 0 and 255.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        finite = bool(np.isfinite([self.low, self.high]).all())
        require(finite and self.low < self.high, "window", (self.low, self.high), "two rising ends")

    def grey(self, voxels: NDArray[Any]) -> NDArray[Any]:
        """Return grey levels in C order: unchanged uint8 for the window 0 to 255, else float32."""
        if voxels.dtype == np.uint8 and (self.low, self.high) == (0, 255):
            return np.ascontiguousarray(voxels)
        levels = np.array(voxels, np.float32, order="C")
        if (self.low, self.high) != (0, 255):
            levels -= np.float32(self.low)
            levels *= np.float32(255 / (self.high - self.low))
        return np.clip(levels, 0, 255, out=levels)


def choose_window(voxels: NDArray[Any]) -> GreyWindow:
    """Choose a window for the volumes of a recording; all of them must share it.

    8-bit numbers are grey levels and stay as they are. So do other numbers that look like grey
    levels: they lie between 0 and 255 and their maximum is above half of that range. Floating-point
    numbers between 0 and 1 are treated likewise and multiplied by 255. Otherwise the lowest number,
    which also fills the space outside the field of view, becomes 0. The highest becomes 255, or the
    99.9 % quantile if the highest is an outlier. The numbers should be log-compressed: take the
    logarithm of linear amplitudes first.
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
