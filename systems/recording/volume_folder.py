"""Reader of a folder with a file for each volume, as many laboratories keep them."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.natural_order import natural_order
from sonoservo.systems.files.plus_fields import SEQUENCE_FIELDS, sequence_field
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.volume_file import MAX_FILES, SCALE, VolumeFile

_ONLY = "Seq_Frame0000_"  # beginning of the names of the fields of a file's only volume
# A number in a name, with decimals unless it is part of a date or a version.
_NUMBER = re.compile(r"(?<![\d.])\d+\.\d+(?!\.?\d)|\d+")


def open_volume_folder(
    path: Path, files: Sequence[Path], open_one: Callable[[Path], VolumeFile]
) -> VolumeFile:
    """Open files of one volume each as a sequence; their grids and kinds of voxels must agree.

    Transforms, time and status in the header of a file are those of its volume.
    """
    if len(files) > MAX_FILES:
        raise ConfigurationError(f"{path}: {len(files)} files; at most {MAX_FILES} are allowed")
    files = _in_order(files)
    volumes = [open_one(each) for each in files]
    first = volumes[0]
    fields, times = dict(first.fields), []
    for number, each in enumerate(volumes):
        if each.count != 1:
            raise ConfigurationError(
                f"{each.path}: {each.count} volumes; in a folder, each file holds one"
            )
        same = (each.shape, each.channels, each.void) == (first.shape, first.channels, first.void)
        if not same or not np.allclose(each.directions, first.directions, rtol=1e-6):
            raise ConfigurationError(
                f"{each.path}: size, spacing, axes or channels differ from those of {first.path}"
            )
        if not np.allclose(each.origin, first.origin, atol=1e-3):
            raise ConfigurationError(
                f"{each.path}: its origin {each.origin.tolist()} mm differs from that of "
                f"{first.path}; poses belong into the fields of transforms"
            )
        for name in (*SEQUENCE_FIELDS, SCALE):
            here, there = (sequence_field(file.fields, name) for file in (each, first))
            if here.upper() != there.upper():
                raise ConfigurationError(
                    f"{each.path}: {name}: {here or 'missing'}; that of {first.path} is "
                    f"{there or 'missing'}, and all must agree"
                )
        for name, value in each.fields.items():
            if name.startswith(_ONLY):
                fields[name.replace(_ONLY, f"Seq_Frame{number:04d}_")] = value
        times.append(np.nan if each.times is None else float(each.times[0]))
    types: dict[str, Path] = {}  # of voxels, each with the first file read that has it

    def read(number: int) -> NDArray[Any]:
        voxels = volumes[number].read(0)
        here = voxels.dtype.name
        types.setdefault(here, files[number])
        kind, example = next(iter(types.items()))
        if here != kind:
            raise ConfigurationError(
                f"{files[number]}: its voxels are of the type {here}, and those of {example} of "
                f"{kind}; all must agree"
            )
        return voxels

    return replace(
        first,
        path=path,
        count=len(volumes),
        read=read,
        times=None if np.isnan(times).any() else np.array(times),
        fields=fields,
        notes=(
            *dict.fromkeys(note for each in volumes for note in each.notes),
            *_holes([each.stem for each in files]),
        ),
    )


def _in_order(files: Sequence[Path]) -> list[Path]:
    """Return files in the order of the numbers in their names, in which alone these may differ."""
    files = natural_order(files)
    for one, other in pairwise(files):
        if len({re.sub(r"\d+", "0", each.name) for each in (one, other)}) == 2:
            raise ConfigurationError(
                f"{other}: it cannot be ordered beside {one.name}; in a folder of volumes, the "
                "names of files differ in their numbers alone, and label maps lie elsewhere"
            )
        numbers = [list(map(Decimal, _NUMBER.findall(each.name))) for each in (one, other)]
        if numbers[0] > numbers[1]:
            raise ConfigurationError(
                f"{other}: does it come before or after {one.name}? Write as many digits after "
                "the point in each name"
            )
    return files


def _holes(stems: Sequence[str]) -> tuple[str, ...]:
    """Return a note if files are numbered one by one, and some numbers are missing."""
    numbers = [int(re.findall(r"\d+", each)[-1]) for each in stems if re.search(r"\d", each)]
    holes = [(a + 1, b - 1) for a, b in pairwise(numbers) if b > a + 1]
    if len(numbers) < len(stems) or not 0 < len(holes) < len(stems) // 2:
        return ()
    first, last = holes[0]
    shown = f"{first}" if first == last else f"{first} to {last}"
    return (
        f"numbers are missing among the files, such as {shown}; without times, the volumes on both "
        "sides count as neighbours",
    )
