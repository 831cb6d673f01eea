"""Usable volumes or 2D frames of a file: what both have in common."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.counting import counted
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.volume_file import VolumeFile
from sonoservo.systems.recording.formats import open_file
from sonoservo.systems.recording.grey_levels import (
    GreyWindow,
    read_numbers,
    require_echoes,
    void_flags,
    window_of_first,
)
from sonoservo.systems.recording.transform_chain import TransformChain, find_chain
from sonoservo.systems.recording.valid_frames import choose_items, frame_times
from sonoservo.systems.signals.requirements import require_within


class TimesMissingError(ConfigurationError):
    """A file does not say when its volumes or frames were acquired."""


_RATES = 1e-3, 1e4  # Limits of the rate of volumes or frames, in Hz


class FileItems:
    """Volumes or frames of a file that have a pose and a time in order, and their grey levels.

    `path` is the file's and `times` are (n,), in s; `numbers` are those of the items in the file.
    `left_out` are the numbers of the others by reason, and `skipped` counts them; `stated_times`
    are the times of all, in s. Each of the `notes` is a sentence on how the file was read.
    """

    what = "volume"
    looks, enough = 16, 4
    """Number of first items among which the grey levels are chosen, and number of items that
    choose."""

    def __init__(
        self, path: str | Path, orientation: str, void: float | None, luminance: bool
    ) -> None:
        self.path = Path(path)
        self.file: VolumeFile = open_file(
            self.path, frames=self.what == "frame", orientation=orientation
        )
        require_echoes(self.file, luminance)
        self._void = self.file.void if void is None else void
        self._fields = self.file.frame_fields()
        self.notes = list(self.file.notes)
        self.numbers: Sequence[int] = ()
        self._constants: dict[str, NDArray[np.float64]] = {}

    def __len__(self) -> int:
        return len(self.numbers)

    def __repr__(self) -> str:
        duration = float(np.ptp(self.times)) if self.numbers else 0.0
        what = self.what + "s" * (len(self) != 1)
        return f"{type(self).__name__}({str(self.path)!r}, {len(self)} {what}, {duration:.1f} s)"

    def _find_chain(
        self, poses: str | None, transforms: Mapping[str, NDArray[np.float64]] | None
    ) -> TransformChain | None:
        """Return the chain of the transforms, in the file and constant, that gives the poses."""
        self._constants = dict(transforms or {})
        own = [name for name in self._fields if name.endswith("Transform")]
        self._transforms = [*own, *self._constants] if own else []
        return find_chain(self.path, self._transforms, poses)

    def _stated_times(self, rate: float | None, timed: bool = True) -> NDArray[np.float64]:
        """Return the times of all items by their rate in Hz, by their stamps or by the file.

        If they are not ``timed``, these are their numbers.
        """
        count = self.file.count
        if not timed:
            return np.arange(count, dtype=float)
        if rate is not None:
            require_within("volume rate", rate, *_RATES)
            if "Timestamp" in self._fields or self.file.times is not None:
                self.notes.append(
                    f"the times in the file are set aside for {rate:g} "
                    f"{self.what}{'s' * (rate != 1)} a second"
                )
            return np.arange(count) / rate
        if "Timestamp" in self._fields:
            return frame_times(count, self._fields["Timestamp"])
        if self.file.times is not None:
            return self.file.times
        if count == 1:
            return np.zeros(1)
        unread = "".join(f"; {each}" for each in self.notes if "time" in each)
        raise TimesMissingError(
            f"{self.path}: the times of its {self.what}s are missing; give their rate "
            f"(--volume-rate){unread}"
        )

    def _choose(
        self, chain: TransformChain | None, times: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Choose the usable items, and return their (n, 4, 4) poses by the chain, in mm."""
        items = choose_items(
            self.path, self.file.count, self._fields, chain, self._constants, times, self.what
        )
        self.numbers, self.times = items.numbers.tolist(), items.times
        self.left_out, self.stated_times = items.left_out, times
        self.skipped = self.file.count - len(self.numbers)
        self.notes += [*([f"poses: {chain}"] if chain else []), *items.note(self.what)]
        return items.matrices

    def _pixels(self, number: int) -> NDArray[Any]:
        """Return the numbers of an item, by its number in the file."""
        return read_numbers(self.file, number)

    def _choose_window(self) -> GreyWindow:
        """Return the window that all items share, and note how it was chosen."""
        chosen, blank = window_of_first(map(self._pixels, self.numbers[: self.looks]), self.enough)
        first = self._pixels(self.numbers[0])
        void = void_flags(first, self._void)
        if void is not None and void.all() and blank == len(self.numbers):
            raise ConfigurationError(
                f"{self.path}: {self.what} {self.numbers[0]} holds values that are not finite, or "
                "stand for what was not seen, and so do all others"
            )
        if first.dtype != np.uint8:
            said = f"grey levels: {chosen.low:g} is black and {chosen.high:g} white (--window)"
            more = f", chosen without {counted(blank, f'blank {self.what}')}" if blank else ""
            self.notes.append(said + more)
        return chosen
