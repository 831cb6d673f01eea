"""Reader of a folder of PNG images with a table of their poses."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.counting import counted
from sonoservo.systems.files.natural_order import natural_order
from sonoservo.systems.files.refusals import ConfigurationError, require_extra
from sonoservo.systems.files.volume_file import VolumeFile, check_layout, require_frames
from sonoservo.systems.recording.grey_levels import as_frame, most_channels
from sonoservo.systems.recording.pose_table import read_pose_table

TABLE = "poses.csv"
"""Name of the table, if a folder holds several."""


def open_png_folder(path: Path, files: Sequence[Path], *, frames: bool = False) -> VolumeFile:
    """Open PNG images of a folder in the order of their names, 9 before 10, with a pose table."""
    image = require_extra("PIL.Image", "images", path)
    files = natural_order(files)
    require_frames(path, frames, f"{len(files)} PNG images")
    tables = sorted(path.glob("*.csv"))
    table = path / TABLE if path / TABLE in tables or len(tables) != 1 else tables[0]
    if not table.is_file():
        raise ConfigurationError(
            f"{table}: there is no such table of poses; the folder is taken for one of PNG images, "
            f"as it holds {files[0].name}"
        )
    fields, notes = read_pose_table(table, [each.name for each in files])
    rows = len({name[: len("Seq_Frame0000")] for name in fields})
    if rows < len(files):
        notes.append(f"{counted(len(files) - rows, 'image')} without a row in {table.name}")

    def pixels(number: int) -> NDArray[Any]:
        with image.open(files[number]) as opened:
            if opened.mode == "P":
                opened = opened.convert("RGB")
            return np.swapaxes(np.asarray(opened), 0, 1)

    def readable(number: int) -> NDArray[Any] | None:
        """Return the pixels of an image; None if it cannot be read."""
        try:
            return pixels(number)
        except (OSError, ValueError, SyntaxError):
            return None

    first = next((each for n in range(len(files)) if (each := readable(n)) is not None), None)
    if first is None:
        raise ConfigurationError(f"{path}: none of its {len(files)} PNG images can be read")
    shape, channels = first.shape, most_channels(readable, len(files))
    size = (shape[0], shape[1], 1)
    check_layout(path, size, len(files), np.eye(3), frames=True)

    def read(number: int) -> NDArray[Any]:
        here = readable(number)
        if here is None:  # it costs itself, as a frame that holds nothing
            return np.full((*size, *(() if channels == 1 else (channels,))), np.nan, np.float32)
        if here.shape != shape:
            raise ConfigurationError(
                f"{files[number]}: {here.shape} pixels; the first image has {shape}"
            )
        return as_frame(here, channels, str(files[number]))

    return VolumeFile(
        path, size, len(files), np.eye(3), np.zeros(3), read, None, fields, tuple(notes), channels
    )
