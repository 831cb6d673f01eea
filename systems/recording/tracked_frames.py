"""Reader of tracked 2D frames as PLUS and others record them."""

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.volume_file import check_grid
from sonoservo.systems.recording.dicom import FIRST_PIXEL
from sonoservo.systems.recording.file_items import FileItems
from sonoservo.systems.recording.grey_levels import GreyWindow, void_flags
from sonoservo.systems.recording.transform_chain import TransformChain, find_chain


class TrackedFrames(FileItems):
    """2D frames with poses and times, read on demand; see `Recording` for the arguments it shares.

    `X_WI` (n, 4, 4) leads from pixels (i, j, 0, 1) to W, the reference frame, in m. A chain of
    ``poses`` that begins at the image maps pixels, others mm in the frame.
    """

    what = "frame"
    looks, enough = 128, 32

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
        clip: tuple[int, int, int, int] | None = None,  # first pixel and size, (i, j, ni, nj)
    ) -> None:
        self.void: set[int] = set()  # numbers of the frames read so far that hold nothing
        with refusing_failures(path):
            super().__init__(path, orientation, void, luminance)
            chain = self._find_chain(poses, transforms)
            if chain is None:
                raise ConfigurationError(
                    f"{self.path}: its frames have no poses, which reconstruction needs"
                )
            chain = self._from_the_image(chain)
            matrices = self._choose(chain, self._stated_times(frame_rate))
            if len(self) < 2:
                why = f"; {self.notes[-1]}" if self.skipped else ""
                raise ConfigurationError(
                    f"{self.path}: frames with a valid pose: {len(self)}; at least 2 are needed"
                    f"{why}"
                )
            if not chain.start.startswith("Image"):
                spacings = self._fields.get("ElementSpacing", {})
                pixels = [self._pixel_size(spacings.get(k)) for k in self.numbers]
                matrices = matrices @ np.array(pixels)
            self.X_WI = np.array([self._in_metres(matrix) for matrix in matrices])
            self._move(*map(int, self.file.fields.get(FIRST_PIXEL, "0 0").split()))
            self._clip = self._cut(clip)
            self._window = GreyWindow(*window) if window else self._choose_window()

    def _from_the_image(self, chain: TransformChain) -> TransformChain:
        """Return a chain that begins at the image, if only the calibration is missing in it."""
        if chain.start.startswith("Image"):
            return chain
        names = [name.removesuffix("Transform") for name in self._transforms]
        name = f"ImageTo{chain.start}"
        own = find_chain(self.path, names, name) if (
            name in names or f"{chain.start}ToImage" in names
        ) else None  # fmt: skip
        if own is not None:
            return TransformChain("Image", chain.end, (*own.links, *chain.links))
        if misspelt := get_close_matches(name, names, 1, cutoff=0.85):
            raise ConfigurationError(f"{self.path}: {misspelt[0]}: unknown; did you mean {name!r}?")
        spacing = np.linalg.norm(self.file.directions[:, :2], axis=0)
        if np.allclose(spacing, 1.0) and "ElementSpacing" not in self._fields:
            raise ConfigurationError(
                f"{self.path}: the calibration {name} is missing, which tells the size and place "
                "of the pixels; give it with --calibration or --plus-config"
            )
        return chain

    def __iter__(self) -> Iterator[NDArray[Any]]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, number: int) -> NDArray[np.uint8] | NDArray[np.float32]:
        """Read the (ni, nj) grey levels of a frame."""
        with refusing_failures(self.path, f"frame {number}"):
            pixels = self._pixels(self.numbers[number])[..., 0][self._clip]
            void = void_flags(pixels, self._void)
            if void is not None and void.all():
                self.void.add(self.numbers[number])
            return self._window.grey(pixels, void)

    def _cut(self, clip: tuple[int, int, int, int] | None) -> tuple[slice, slice]:
        """Return the part of a frame that is read, to which the poses are moved."""
        if clip is None:
            return slice(None), slice(None)
        i, j, ni, nj = clip
        if i + ni > self.file.shape[0] or j + nj > self.file.shape[1]:
            size = f"{self.file.shape[0]} x {self.file.shape[1]}"
            raise ConfigurationError(
                f"{self.path}: a rectangle of {ni} x {nj} pixels from {i}, {j} on (ClipRectangle) "
                f"reaches beyond the frames of {size}"
            )
        self._move(i, j)
        return slice(i, i + ni), slice(j, j + nj)

    def _move(self, i: int, j: int) -> None:
        """Let the poses lead from pixels that count from pixel (i, j) of those so far."""
        self.X_WI[:, :3, 3] += self.X_WI[:, :3, 0] * i + self.X_WI[:, :3, 1] * j

    def _pixel_size(self, spacing: str | None) -> NDArray[np.float64]:
        """Return the (4, 4) transform from pixels to mm, by a frame's own spacing or the header."""
        header = np.eye(4)
        header[:3, :3], header[:3, 3] = self.file.directions, self.file.origin
        if spacing is not None:
            own = np.array(spacing.split()[:2], float)
            header[:3, :2] *= own / np.linalg.norm(header[:3, :2], axis=0)
        return header

    def _in_metres(self, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
        check_grid(self.path, self.file.shape[:2], matrix[:3, :2], matrix[:3, 3], square=False)
        matrix = matrix.copy()
        matrix[:3] *= 1e-3
        return matrix
