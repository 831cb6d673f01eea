"""Conversion of a file's numbers to grey levels."""

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.volume_file import VolumeFile
from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.requirements import require

_MAX_NUMBER = 1e30
"""Largest magnitude of a number in a file; single precision ends at 3e38."""

_MIN_WIDTH = 1e-30
"""Smallest width of a window."""

_FAR = 1e4
"""Distance of a window from zero, in widths, from which double precision is used."""

_ALMOST_ALL = 0.999
"""Quantile of the numbers in the field of view that replaces a maximum far above it."""

_REMEMBERED = 8
"""Number of volumes that share in the choice of a window."""

_OTHER = 1.25
"""Ratio of the widths of two windows from which they are not the same."""


def read_numbers(file: VolumeFile, number: int) -> NDArray[Any]:
    """Return the numbers of a volume or frame as the file has them.

    Raises
    ------
    ConfigurationError
        If the file ends earlier, or a number is not finite or implausibly large.
    """
    numbers = file.read(number)
    if numbers.dtype.kind == "f":
        largest = max(-float(numbers.min()), float(numbers.max()))  # NaN if one is NaN
        if not np.isfinite(largest):
            raise ConfigurationError(
                f"{file.path}: volume {number} holds values that are not finite"
            )
        if largest > _MAX_NUMBER:
            raise ConfigurationError(
                f"{file.path}: volume {number} holds values up to {largest:.3g}; at most "
                f"{_MAX_NUMBER:g} is allowed, and log-compressed echoes are expected"
            )
    return numbers


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
        plausible = bool((np.abs([self.low, self.high]) <= _MAX_NUMBER).all())
        require(
            plausible and self.high - self.low > _MIN_WIDTH,
            "window",
            (self.low, self.high),
            f"two rising ends within +-{_MAX_NUMBER:g}",
        )

    def grey(self, voxels: NDArray[Any]) -> NDArray[Any]:
        """Return grey levels in C order: unchanged uint8 for the window 0 to 255, else float32."""
        if voxels.dtype == np.uint8 and (self.low, self.high) == (0, 255):
            return np.ascontiguousarray(voxels)
        # Single precision is too coarse for a window far from zero.
        far = max(abs(self.low), abs(self.high)) > _FAR * (self.high - self.low)
        levels: NDArray[Any] = np.array(voxels, np.float64 if far else np.float32, order="C")
        if (self.low, self.high) != (0, 255):
            levels -= levels.dtype.type(self.low)
            levels *= levels.dtype.type(255 / (self.high - self.low))
        return np.clip(levels, 0, 255, out=levels).astype(np.float32, copy=False)


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


class GreyLevels:
    """Turns the numbers of a stream's volumes into grey levels, with one window for all of them.

    The window holds what the last volumes that showed something ask for (`choose_window`). A volume
    without any contrast chooses nothing, and is black. Unless it is `held`, the window follows when
    a quarter more or less would do: the first volume may have been dim, or a test picture.

    Parameters
    ----------
    window
        Numbers that become 0 and 255; by default, the volumes choose them.

    Attributes
    ----------
    held
        True while something is tracked, whose echoes must not change by themselves.
    window
        Present window; None while no volume has shown anything.
    """

    def __init__(self, window: tuple[float, float] | None = None) -> None:
        self._given = window is not None
        self.window = GreyWindow(*window) if window else None
        self.held = False
        self._asked: deque[GreyWindow] = deque(maxlen=_REMEMBERED)

    def __call__(self, voxels: NDArray[Any]) -> NDArray[Any]:
        """Return the grey levels of a volume or frame, in C order."""
        if not self._given and (self.window is None or not self.held):
            self._follow(voxels)
        if self.window is None:
            return np.zeros(voxels.shape, np.float32)
        return self.window.grey(voxels)

    def _follow(self, voxels: NDArray[Any]) -> None:
        if self.window is not None:  # to follow, a part of the numbers is enough
            voxels = voxels[(slice(None, None, 3),) * voxels.ndim]
        if voxels.dtype != np.uint8 and voxels.min() == voxels.max():
            return
        self._asked.append(choose_window(voxels))
        low, high = min(w.low for w in self._asked), max(w.high for w in self._asked)
        ratio = 0.0 if self.window is None else (high - low) / (self.window.high - self.window.low)
        if not 1 / _OTHER < ratio < _OTHER:
            self.window = GreyWindow(low, high)
