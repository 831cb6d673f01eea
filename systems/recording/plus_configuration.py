"""Device-set configurations of PLUS, and calibrations given as a matrix."""

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.volume_file import number_or_nan
from sonoservo.systems.recording.valid_frames import read_matrix
from sonoservo.systems.signals.immutable import Immutable

_MOST_BYTES = 1 << 24


@dataclass(frozen=True)
class KnownTransform(Immutable):
    """A (4, 4) transform in mm, its error in mm (NaN if unknown), and its date."""

    matrix: NDArray[np.float64]
    error: float = np.nan
    date: str = ""


@dataclass(frozen=True)
class PlusConfiguration(Immutable):
    """Transforms by name, such as ``ImageToProbe``, and settings of a device-set configuration."""

    transforms: dict[str, KnownTransform] = field(default_factory=dict)
    orientation: str = ""
    time_offset: float = 0.0
    """Time in s by which the images' devices are set back against the trackers'
    (``LocalTimeOffsetSec``), which PLUS has applied to what it records and sends."""
    clip: tuple[int, int, int, int] | None = None
    """First pixel and size, (i, j, ni, nj), of the part of a frame that shows tissue
    (``ClipRectangleOrigin``, ``ClipRectangleSize``), if stated."""

    @property
    def matrices(self) -> dict[str, NDArray[np.float64]]:
        """(4, 4) matrices of the transforms by name, in mm."""
        return {name: each.matrix for name, each in self.transforms.items()}

    def notes(self) -> tuple[str, ...]:
        """Sentences about its transforms, orientation and time offset."""
        said = []
        for name, each in self.transforms.items():
            error = "" if np.isnan(each.error) else f", error {each.error:g} mm"
            said.append(f"{name}{error}{f', of {each.date}' if each.date else ''}")
        notes = [f"the configuration gives {'; '.join(said)}"] if said else []
        if self.orientation:
            notes.append(f"its images have the orientation {self.orientation}")
        if self.time_offset:
            notes.append(
                f"its images are set back by {self.time_offset:g} s against the poses; PLUS has "
                "applied that to what it recorded"
            )
        if self.clip is not None:
            notes.append("frames are cut to {2} x {3} pixels from {0}, {1} on".format(*self.clip))
        return tuple(notes)


def read_plus_configuration(path: Path) -> PlusConfiguration:
    """Read a device-set configuration of PLUS (``PlusConfiguration``)."""
    if not path.is_file():
        raise ConfigurationError(f"{path}: there is no such file")
    with refusing_failures(path, "it is not XML"):
        text = path.read_bytes()
        if len(text) > _MOST_BYTES or b"<!DOCTYPE" in text or b"<!ENTITY" in text:
            raise ConfigurationError(f"{path}: it is no configuration of PLUS")
        root = ET.fromstring(text)
    if root.tag != "PlusConfiguration":
        raise ConfigurationError(
            f"{path}: it is no configuration of PLUS: it begins with {root.tag}"
        )
    transforms = {}
    for each in root.iter("Transform"):
        start, end, matrix = (each.get(name, "") for name in ("From", "To", "Matrix"))
        if not matrix:
            continue
        name = f"{start}To{end}"
        transforms[name] = KnownTransform(
            read_matrix(path, name, matrix),
            number_or_nan(each.get("Error")),
            each.get("Date", "").strip(),
        )
    return PlusConfiguration(transforms, _orientation(root), _time_offset(root), _clip(root))


def _orientation(root: ET.Element) -> str:
    names = ("PortUsImageOrientation", "UsImageOrientation", "PortImageOrientation")
    found = {
        each.get(name, "").strip().upper()
        for each in root.iter()
        for name in names
        if each.get(name)
    }
    return found.pop() if len(found) == 1 else ""


def _clip(root: ET.Element) -> tuple[int, int, int, int] | None:
    """Return the rectangle to which frames are cut; None if there is none, or several."""
    found = {
        (each.get("ClipRectangleOrigin", ""), each.get("ClipRectangleSize", ""))
        for each in root.iter("VolumeReconstruction")
    }
    words = " ".join(found.pop()).split() if len(found) == 1 else []
    numbers = [int(word) for word in words if word.lstrip("-").isdecimal()]
    if len(numbers) != 4 or min(numbers[:2]) < 0 or min(numbers[2:]) < 2:
        return None
    return numbers[0], numbers[1], numbers[2], numbers[3]


def _time_offset(root: ET.Element) -> float:
    """Return the offset of the devices with images less that of the devices with tools, in s."""
    images: list[float] = []
    tools: list[float] = []
    for device in root.iter("Device"):
        offset = number_or_nan(device.get("LocalTimeOffsetSec"))
        if np.isnan(offset):
            continue
        kinds = {source.get("Type", "").lower() for source in device.iter("DataSource")}
        (tools if "tool" in kinds else images if "video" in kinds else []).append(offset)
    return _only(images) - _only(tools)


def _only(offsets: Iterable[float]) -> float:
    different = set(offsets)
    return different.pop() if len(different) == 1 else 0.0


def _numbers_of(line: str) -> list[str]:
    """Return the words of a line; none if it holds names alone."""
    words = line.replace(",", " ").replace(";", " ").split()
    return [] if words and all(np.isnan(number_or_nan(each)) for each in words) else words


def read_calibration(text: str) -> tuple[str, NDArray[np.float64]]:
    """Read name and (4, 4) matrix of a calibration in mm: 16 numbers row by row, or a file of them.

    ``NAME=`` before it names another transform than ImageToProbe. Lines of names are passed over.
    Of two matrices, the first turns pixels into mm, and their product is meant
    (``calib_matrix.csv`` of TUS-REC).
    """
    name, equals, rest = text.partition("=")
    if not equals or "To" not in name or " " in name.strip():
        name, rest = "ImageToProbe", text
    path = Path(rest.strip())
    try:
        numbers = path.read_text(encoding="utf-8") if path.is_file() else rest
    except (OSError, UnicodeDecodeError, ValueError):
        numbers = rest
    words = [each for line in numbers.splitlines() for each in _numbers_of(line)]
    source = path if path.is_file() else Path("calibration")
    if len(words) == 32:
        scale, turn = (
            read_matrix(source, name, " ".join(part)) for part in (words[:16], words[16:])
        )
        return name.strip(), turn @ scale
    if not words:
        raise ConfigurationError(
            f"calibration: there is no file {rest[:60]!r} with numbers; expected 16, row by row"
        )
    if len(words) != 16:
        raise ConfigurationError(f"{source}: {len(words)} numbers; expected 16, row by row")
    return name.strip(), read_matrix(source, name, " ".join(words))
