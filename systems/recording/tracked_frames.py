"""Reader of tracked 2D frames as PLUS and others record them."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.volume_file import VolumeFile, check_grid
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

# Numbers of first frames among which those are that choose the grey levels, and of these.
_LOOKS, _ENOUGH = 128, 32


class TrackedFrames:
    """2D frames with poses and times, read on demand, one at a time.

    See `Recording` for the arguments it shares. A chain of ``poses`` that begins at the image maps
    pixels, others mm in the frame. ``clip`` is first pixel and size, (i, j, ni, nj), of the part of
    a frame that shows tissue. ConfigurationError if the file is not valid.

    `times` are (n,), in s, and `numbers` those of the frames in the file; X_WI is (n, 4, 4), from
    pixels (i, j, 0, 1) to W, in m: the reference frame. `skipped` counts frames left out: marked as
    invalid, or without a pose or a time in order. `void` has the numbers of those read so far that
    hold nothing. Each of the `notes` is a sentence on how the file was read.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        poses: str | None = None,
        window: tuple[float, float] | None = None,
        frame_rate: float | None = None,
        transforms: Mapping[str, NDArray[np.float64]] | None = None,
        orientation: str = "",
        void: float | None = None,
        luminance: bool = False,
        clip: tuple[int, int, int, int] | None = None,
    ) -> None:
        self.path = Path(path)
        self.void: set[int] = set()
        with refusing_failures(self.path):
            self._file = open_file(self.path, frames=True, orientation=orientation)
            require_echoes(self._file, luminance)
            self._void = self._file.void if void is None else void
            self._open(poses, dict(transforms or {}), frame_rate)
            self._clip = self._cut(clip)
            self._window = GreyWindow(*window) if window else self._choose_window()

    def _open(
        self,
        poses: str | None,
        constants: dict[str, NDArray[np.float64]],
        frame_rate: float | None,
    ) -> None:
        fields, count = self._file.frame_fields(), self._file.count
        names = [name.removesuffix("Transform") for name in fields if name.endswith("Transform")]
        chain = find_chain(self.path, [*names, *constants], poses) if names else None
        if chain is None:
            raise ConfigurationError(
                f"{self.path}: its frames have no poses, which reconstruction needs"
            )
        chain = self._from_the_image(chain, [*names, *constants])
        if frame_rate is not None:
            times = np.arange(count) / frame_rate
        elif "Timestamp" in fields or self._file.times is None:
            times = frame_times(count, fields.get("Timestamp", {}))
        else:
            times = self._file.times
        if np.isnan(times).all():
            raise ConfigurationError(
                f"{self.path}: the times of its frames are missing; give their rate (--volume-rate)"
            )
        items = choose_items(self.path, count, fields, chain, constants, times, "frame")
        self.numbers, self.times = items.numbers, items.times
        self.skipped = count - len(self.numbers)
        if len(self.numbers) < 2:
            raise ConfigurationError(
                f"{self.path}: {len(self.numbers)} frames have a valid pose; at least 2 are needed"
            )
        spacings = fields.get("ElementSpacing", {})
        in_pixels = chain.start.startswith("Image")
        self.X_WI = np.array(
            [
                self._in_metres(
                    matrix if in_pixels else matrix @ self._pixels(spacings.get(int(k)))
                )
                for k, matrix in zip(items.numbers, items.matrices, strict=True)
            ]
        )
        self.notes = [*self._file.notes, f"poses: {chain}", *items.note("frame")]

    def _from_the_image(self, chain: TransformChain, names: list[str]) -> TransformChain:
        """Return a chain that begins at the image, if only the calibration is missing in it."""
        if chain.start.startswith("Image"):
            return chain
        own = find_chain(self.path, names, f"ImageTo{chain.start}") if (
            f"ImageTo{chain.start}" in names or f"{chain.start}ToImage" in names
        ) else None  # fmt: skip
        if own is not None:
            return TransformChain("Image", chain.end, (*own.links, *chain.links))
        spacing = np.linalg.norm(self._file.directions[:, :2], axis=0)
        if np.allclose(spacing, 1.0) and "ElementSpacing" not in self._file.frame_fields():
            raise ConfigurationError(
                f"{self.path}: the calibration ImageTo{chain.start} is missing, which tells the "
                f"size and place of the pixels; give it with --calibration or --plus-config"
            )
        return chain

    def _choose_window(self) -> GreyWindow:
        looks = (read_numbers(self._file, int(k)) for k in self.numbers[:_LOOKS])
        chosen, blank = window_of_first(looks, _ENOUGH)
        if read_numbers(self._file, int(self.numbers[0])).dtype != np.uint8:
            said = f"grey levels: {chosen.low:g} is black and {chosen.high:g} white (--window)"
            self.notes.append(said + (f"; {blank} blank frames did not choose" if blank else ""))
        return chosen

    @property
    def file(self) -> VolumeFile:
        """The file as its header describes it."""
        return self._file

    def __len__(self) -> int:
        return len(self.numbers)

    def __iter__(self) -> Iterator[NDArray[Any]]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, number: int) -> NDArray[np.uint8] | NDArray[np.float32]:
        """Read the (ni, nj) grey levels of a frame."""
        with refusing_failures(self.path, f"frame {number}"):
            pixels = read_numbers(self._file, int(self.numbers[number]))[..., 0][self._clip]
            void = void_flags(pixels, self._void)
            if void is not None and void.all():
                self.void.add(int(self.numbers[number]))
            return self._window.grey(pixels, void)

    def _cut(self, clip: tuple[int, int, int, int] | None) -> tuple[slice, slice]:
        """Return the part of a frame that is read, to which the poses are moved."""
        if clip is None:
            return slice(None), slice(None)
        i, j, ni, nj = clip
        if i + ni > self._file.shape[0] or j + nj > self._file.shape[1]:
            size = f"{self._file.shape[0]} x {self._file.shape[1]}"
            raise ConfigurationError(
                f"{self.path}: a rectangle of {ni} x {nj} pixels from {i}, {j} on (ClipRectangle) "
                f"reaches beyond the frames of {size}"
            )
        self.X_WI[:, :3, 3] += self.X_WI[:, :3, 0] * i + self.X_WI[:, :3, 1] * j
        return slice(i, i + ni), slice(j, j + nj)

    def _pixels(self, spacing: str | None) -> NDArray[np.float64]:
        """Return the (4, 4) transform from pixels to mm, by a frame's own spacing or the header."""
        header = np.eye(4)
        header[:3, :3], header[:3, 3] = self._file.directions, self._file.origin
        if spacing is not None:
            own = np.array(spacing.split()[:2], float)
            header[:3, :2] *= own / np.linalg.norm(header[:3, :2], axis=0)
        return header

    def _in_metres(self, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
        check_grid(self.path, self._file.shape[:2], matrix[:3, :2], matrix[:3, 3], square=False)
        matrix = matrix.copy()
        matrix[:3] *= 1e-3
        return matrix
