"""Fields that PLUS writes into headers, and what they mean for the voxels."""

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.volume_file import FieldUse, VolumeFile

SEQUENCE_FIELDS = {
    "UltrasoundImageOrientation": FieldUse.USED,
    "UltrasoundImageType": FieldUse.CHECKED,
}
"""Fields of a whole file. In NRRD they are spelt ``ultrasound image orientation``, too."""

FRAME_FIELDS = {
    "Transform": FieldUse.USED,
    "TransformStatus": FieldUse.USED,
    "Timestamp": FieldUse.USED,
    "ImageStatus": FieldUse.USED,
    "ElementSpacing": FieldUse.USED,
    "FrameSize": FieldUse.CHECKED,
    "UnfilteredTimestamp": FieldUse.NO_EFFECT,
    "FrameNumber": FieldUse.NO_EFFECT,
}
"""Fields of a volume or frame, ``Seq_Frame0012_Name``; the first two end a transform's name."""

_FRAME_FIELD = re.compile(r"Seq_Frame\d+_(\w+)")
# Axis of the probe (lateral, axial, elevation) that a letter stands for, and its sign in MFA.
_LETTERS = {"M": (0, 1), "U": (0, -1), "F": (1, 1), "N": (1, -1), "A": (2, 1), "D": (2, -1)}
_RAW = {
    "RF_REAL": "real radio-frequency samples",
    "RF_IQ_LINE": "radio-frequency samples, I and Q",
    "RF_I_LINE_Q_LINE": "radio-frequency samples, I and Q",
    "RF_IQ": "radio-frequency samples, I and Q",
}


def _is_frame_field(name: str) -> bool:
    return name in FRAME_FIELDS or name.endswith(("Transform", "TransformStatus"))


def numbered_fields(
    fields: Mapping[str, str], known: Mapping[str, FieldUse], count: int
) -> dict[str, str]:
    """Return fields with the number of their volume.

    Those of a file's only volume may have none, and a transform without one, such as the
    calibration, is that of all, with its status. ``known`` are the fields of a whole file, and
    ``count`` is the number of its volumes.
    """
    numbered, others = dict[str, str](), dict[str, str]()
    for name, value in fields.items():
        plain = _is_frame_field(name) and name not in known and not _FRAME_FIELD.fullmatch(name)
        if plain and (count == 1 or name.endswith(("Transform", "TransformStatus"))):
            numbered |= {f"Seq_Frame{k:04d}_{name}": value for k in range(count)}
        else:
            others[name] = value
    return numbered | others


def refuse_misspelt(
    path: Path,
    names: Collection[str],
    known: Mapping[str, FieldUse],
    given: Collection[str] = (),
) -> None:
    """Raise ConfigurationError if an unknown field is nearly one that is used, and missing.

    ``known`` are the fields of a whole file; those ``given`` under other names are not missing.
    """
    spellings = {_spelling(each) for each in SEQUENCE_FIELDS}
    for name in names:
        if match := _FRAME_FIELD.fullmatch(name):
            meant = name.removesuffix(match[1]) + _nearest_of_frame(match[1])
        else:
            right = _spelling(name) in spellings
            meant = name if right else _nearest(name, {**SEQUENCE_FIELDS, **known})
        if meant not in names and meant not in given:
            raise ConfigurationError(f"{path}: {name}: unknown; did you mean {meant!r}?")


def _nearest(name: str, fields: Mapping[str, FieldUse]) -> str:
    """Return the used field that a name nearly is, or else the name."""
    near = get_close_matches(name, fields, 1, cutoff=0.85)
    return near[0] if near and fields[near[0]] == FieldUse.USED else name


@lru_cache(maxsize=256)
def _nearest_of_frame(name: str) -> str:
    """Return the used field of a volume or frame that a name nearly is, or else the name."""
    if _is_frame_field(name):
        return name
    ends = [name[k:].lower() for k in range(len(name))]
    for field in ("Transform", "TransformStatus"):  # after the transform's name
        if near := get_close_matches(field.lower(), ends, 1, cutoff=0.85):
            return name[: -len(near[0])] + field
    return _nearest(name, FRAME_FIELDS)


def unknown_fields(
    format_name: str, fields: Iterable[str], known: Mapping[str, FieldUse]
) -> tuple[str, ...]:
    """Return a note that names the fields of a header that are in no table, if there are any."""
    names = {_spelling(name) for name in (*known, *SEQUENCE_FIELDS)}
    unknown: set[str] = set()
    for name in fields:
        if match := _FRAME_FIELD.fullmatch(name):
            if not _is_frame_field(match[1]):
                unknown.add(f"Seq_Frame..._{match[1]}")
        elif _spelling(name) not in names:
            unknown.add(name)
    if not unknown:
        return ()
    shown = sorted(unknown)[:5]
    more = f" and {len(unknown) - 5} more" if len(unknown) > 5 else ""
    return (f"these fields of the {format_name} header have no effect: {', '.join(shown)}{more}",)


def sequence_field(fields: Mapping[str, str], name: str) -> str:
    """Return a field of a whole file, however it is spelt; empty if it is missing."""
    wanted = _spelling(name)
    return next((v.strip() for key, v in fields.items() if _spelling(key) == wanted), "")


def _spelling(name: str) -> str:
    return name.replace(" ", "").lower()


def as_plus_means(file: VolumeFile, orientation: str = "") -> VolumeFile:
    """Return a file with the axes on which PLUS's transforms are defined: marked, far, ascending.

    ``UltrasoundImageOrientation``, or the one given, names the directions of a file's axes. PLUS
    turns the image first, so transforms, spacing and position are those of MF, or MFA.
    """
    kind = sequence_field(file.fields, "UltrasoundImageType").upper()
    if kind in _RAW or kind.startswith("RF"):
        samples = _RAW.get(kind, "radio-frequency samples")
        raise ConfigurationError(
            f"{file.path}: UltrasoundImageType: {kind}: {samples} are no grey levels; make "
            "BRIGHTNESS of them first, as PLUS's RfProcessor does"
        )
    if kind not in ("", "BRIGHTNESS", "RGB_COLOR", "XX", "UNKNOWN"):
        raise ConfigurationError(
            f"{file.path}: UltrasoundImageType: {kind!r} is not allowed; BRIGHTNESS is expected"
        )
    for number, size in file.frame_fields().get("FrameSize", {}).items():
        if [int(n) for n in size.split()[:2]] != list(file.shape[:2]):
            raise ConfigurationError(
                f"{file.path}: FrameSize: that of image {number} is {size!r}, and the file's is "
                f"{file.shape[0]} x {file.shape[1]}"
            )
    letters = sequence_field(file.fields, "UltrasoundImageOrientation").upper()
    if letters in ("XX", "XXX", "UNKNOWN") and not orientation:
        note = f"UltrasoundImageOrientation is {letters}: read as MF, it may be mirrored"
        return replace(file, notes=(*file.notes, note))
    letters = orientation if letters in ("", "XX", "XXX", "UNKNOWN") else letters
    if letters in ("", "MF", "MFA"):
        return file
    flat = file.shape[2] == 1
    axes = [_LETTERS.get(letter, (-1, 0)) for letter in letters]
    if sorted(axis for axis, _ in axes) not in ([0, 1], [0, 1, 2]):
        raise ConfigurationError(
            f"{file.path}: UltrasoundImageOrientation: {letters!r} is not allowed; it has a letter "
            "of each of M or U, F or N and, for volumes, A or D, such as MF or UNA"
        )
    if len(axes) == 2:  # without a letter, the third axis makes the frame right-handed
        turned = axes[0][0] == 1
        mirrored = axes[0][1] * axes[1][1] < 0
        axes.append((2, 1 if flat or mirrored == turned else -1))
    x, y, z = (int(k) for k in np.argsort([axis for axis, _ in axes]))
    order = [x, y, z]
    signs = [axes[k][1] for k in order]
    if flat and order[2] != 2:
        raise ConfigurationError(
            f"{file.path}: UltrasoundImageOrientation: {letters!r} is not allowed for 2D frames"
        )
    backwards = tuple(slice(None, None, sign) for sign in signs)
    read = file.read

    def turned_read(number: int) -> NDArray[Any]:
        voxels = read(number)
        rest = range(3, voxels.ndim)
        return voxels.transpose(*order, *rest)[backwards]

    steps = np.linalg.norm(file.directions, axis=0)
    return replace(
        file,
        shape=(file.shape[x], file.shape[y], file.shape[z]),
        directions=file.directions / steps * steps[order],
        read=turned_read,
        notes=(*file.notes, f"its axes are stored as {letters} and read as MFA"),
    )
