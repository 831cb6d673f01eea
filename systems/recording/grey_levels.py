"""Conversion of a file's numbers to grey levels."""

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.volume_file import VolumeFile
from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.requirements import require

_MAX_NUMBER = 1e30  # Largest magnitude of a number in a file; single precision ends at 3e38
_MIN_WIDTH = 1e-30  # Smallest width of a window
_FAR = 1e4  # Distance of a window from zero, in widths, from which double precision is used
# Quantile of the numbers in the field of view that replaces a maximum far above it.
_ALMOST_ALL = 0.999


_REMEMBERED = 8  # Number of volumes that share in the choice of a window
_OTHER = 1.25  # Ratio of the widths of two windows from which they are not the same
_LOOKS = 20  # Number of images that tell whether there are colours
_LUMINANCE = np.array([0.299, 0.587, 0.114])  # Weights of red, green and blue (ITU-R BT.601)


def luminance(colours: NDArray[Any]) -> NDArray[Any]:
    """Return the grey levels of (..., 3) or (..., 4) colours, as numbers of the same type."""
    grey = colours[..., :3] @ _LUMINANCE
    return (grey if colours.dtype.kind == "f" else np.rint(grey)).astype(colours.dtype)


def grey_or_colours(pixels: NDArray[Any]) -> int:
    """Return the channels of an image: 1 for grey levels, also if saved as equal colours."""
    if pixels.ndim == 2:
        return 1
    grey = (pixels[..., :3] == pixels[..., :1]).all()
    return 1 if grey or pixels.shape[-1] <= 2 else int(pixels.shape[-1])


def most_channels(read: Callable[[int], NDArray[Any] | None], count: int) -> int:
    """Return the channels of images, by some of them: the first may be grey, and others not.

    ``read`` returns one of ``count`` images, or None if it cannot be read.
    """
    looked_at = (read(number) for number in range(0, count, max(1, count // _LOOKS)))
    return max((grey_or_colours(each) for each in looked_at if each is not None), default=1)


def as_frame(pixels: NDArray[Any], channels: int, name: str) -> NDArray[Any]:
    """Return an image of ``channels`` as a volume of one layer, colours along a last axis."""
    if channels == 1 and grey_or_colours(pixels) > 1:
        raise ConfigurationError(
            f"{name}: it is in colour, and the images looked at first are grey; save all as grey"
        )
    layer = pixels[:, :, np.newaxis]
    return layer[..., 0] if pixels.ndim == 3 and channels == 1 else layer


def require_echoes(file: VolumeFile, colours: bool) -> None:
    """Refuse a file of colours unless a person wants their luminance."""
    if file.channels > 1 and not colours:
        raise ConfigurationError(
            f"{file.path}: it holds colours ({file.channels} numbers a voxel, or channels), and "
            "one number, the echo, is expected; --luminance takes the luminance of the colours"
        )


def read_numbers(file: VolumeFile, number: int) -> NDArray[Any]:
    """Return the numbers of a volume or frame as the file has them; those of colours are grey."""
    numbers = file.read(number)
    return luminance(numbers) if file.channels > 1 else numbers


def void_flags(numbers: NDArray[Any], void: float | None = None) -> NDArray[np.bool_] | None:
    """Return flags of the numbers that stand for "nothing was seen here"; None if there are none.

    That is NaN, infinity, above 1e30, the given one, or a number further from the others than these
    from one another: a negative lowest one, or the largest of an integer type of 16 bits or more.
    """
    flags = np.zeros(numbers.shape, bool)
    if numbers.dtype.kind == "f":
        flags = ~(np.abs(numbers) <= _MAX_NUMBER)
    if void is not None:
        flags |= np.isnan(numbers) if np.isnan(void) else numbers == void
    elif numbers.dtype != np.uint8:
        known = numbers[~flags] if flags.any() else numbers
        for mark in _marks(known):
            flags |= numbers == mark
    return flags if flags.any() else None


def _marks(numbers: NDArray[Any]) -> list[Any]:
    """Return the lowest and the highest number, if it can only be a marker of what is void."""
    if numbers.size == 0:
        return []
    low, high = numbers.min(), numbers.max()
    marks = []
    if low < 0:
        others = numbers[numbers > low]
        if others.size and float(others.min()) - float(low) > float(np.ptp(others)) > 0:
            marks.append(low)
    if (
        numbers.dtype.kind in "iu"
        and numbers.dtype.itemsize > 1
        and high == np.iinfo(numbers.dtype).max
    ):
        others = numbers[(numbers < high) & (numbers > low if marks else True)]
        if others.size and float(high) - float(others.max()) > float(np.ptp(others)) > 0:
            marks.append(high)
    return marks


@dataclass(frozen=True)
class GreyWindow(Immutable):
    """Numbers of a file that become the grey levels 0 and 255; what lies beyond them saturates."""

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

    def grey(self, voxels: NDArray[Any], void: NDArray[np.bool_] | None = None) -> NDArray[Any]:
        """Return grey levels in C order, 0 where void: uint8 if unchanged, else float32."""
        if voxels.dtype == np.uint8 and (self.low, self.high) == (0, 255):
            levels = np.ascontiguousarray(voxels)
            return levels if void is None else np.where(void, np.uint8(0), levels)
        # Single precision is too coarse for a window far from zero.
        far = max(abs(self.low), abs(self.high)) > _FAR * (self.high - self.low)
        exact = np.float64 if far or voxels.dtype.itemsize > 4 else np.float32
        levels = np.array(voxels, exact, order="C")
        if void is not None:
            levels[void] = self.low
        if (self.low, self.high) != (0, 255):
            levels -= levels.dtype.type(self.low)
            levels *= levels.dtype.type(255 / (self.high - self.low))
        return np.clip(levels, 0, 255, out=levels).astype(np.float32, copy=False)


def choose_window(*volumes: NDArray[Any]) -> GreyWindow:
    """Choose a window that all volumes of a recording share, by some of them.

    8-bit numbers stay as they are, and so do others up to 255, or up to 1, whose maximum is above
    half of that. Otherwise the lowest number becomes 0, and the highest, or the 99.9 % quantile
    below an outlier, 255. The numbers should be log-compressed; void ones do not count.
    """
    if volumes[0].dtype == np.uint8:
        return GreyWindow(0, 255)
    voxels = np.concatenate([_known(each) for each in volumes])
    if voxels.size == 0:
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


def _known(voxels: NDArray[Any]) -> NDArray[Any]:
    """Return the numbers of a volume that are not void."""
    void = void_flags(voxels)
    return voxels.ravel() if void is None else voxels[~void]


def shows_something(voxels: NDArray[Any]) -> bool:
    """Return True if a volume's numbers, without those that are void, differ."""
    known = _known(voxels)
    return bool(known.size and known.min() != known.max())


def window_of_first(volumes: Iterable[NDArray[Any]], enough: int) -> tuple[GreyWindow, int]:
    """Choose the window from the first ``enough`` volumes that show something."""
    chosen: list[NDArray[Any]] = []
    blank = 0
    for voxels in volumes:
        if voxels.dtype == np.uint8:
            return GreyWindow(0, 255), 0
        if shows_something(voxels):
            chosen.append(voxels)
        else:
            blank += 1
        if len(chosen) == enough:
            break
    return (choose_window(*chosen) if chosen else GreyWindow(0, 255)), blank


class GreyLevels:
    """Turns the numbers of a stream's volumes into grey levels, with one window for all of them.

    A window that is not given covers the last volumes that showed something (`choose_window`).
    Unless it is `held`, as while something is tracked, it follows a change by a quarter.
    """

    def __init__(self, window: tuple[float, float] | None = None) -> None:
        self._given = window is not None
        self.window = GreyWindow(*window) if window else None
        self.held = False
        self._asked: deque[GreyWindow] = deque(maxlen=_REMEMBERED)

    def __call__(self, voxels: NDArray[Any], void: NDArray[np.bool_] | None = None) -> NDArray[Any]:
        """Return the grey levels of a volume or frame, in C order; 0 where ``void`` is set."""
        if not self._given and (self.window is None or not self.held):
            self._follow(voxels)
        if self.window is None:
            return np.zeros(voxels.shape, np.float32)
        return self.window.grey(voxels, void)

    def _follow(self, voxels: NDArray[Any]) -> None:
        if self.window is not None:  # to follow, a part of the numbers is enough
            voxels = voxels[(slice(None, None, 3),) * voxels.ndim]
        if voxels.dtype != np.uint8 and not shows_something(voxels):
            return
        self._asked.append(choose_window(voxels))
        low, high = min(w.low for w in self._asked), max(w.high for w in self._asked)
        ratio = 0.0 if self.window is None else (high - low) / (self.window.high - self.window.low)
        if not 1 / _OTHER < ratio < _OTHER:
            self.window = GreyWindow(low, high)
