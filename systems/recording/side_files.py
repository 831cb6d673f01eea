"""Side files of a recording: the acquisition of its volumes, and the ground truth.

Both are JSON Lines files. The first line describes the file; each further line describes a volume
or a sample of the truth. They are written line by line, in SI units, with numbers that read back
exactly.
"""

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.files.memory import require_memory
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.volume_file import MAX_POSITION
from sonoservo.systems.files.writing import Closing, claim, naming
from sonoservo.systems.recording.sequence_writer import SUFFIX, partial_path
from sonoservo.systems.recording.valid_frames import check_times, require_homogeneous
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.point_spread import PointSpread
from sonoservo.systems.signals.requirements import (
    require,
    require_not_negative,
    require_positive,
    require_within,
)
from sonoservo.systems.signals.sweep import SweepGeometry, SweepMotion
from sonoservo.systems.signals.volume import Volume

ACQUISITION, TRUTH = ".acquisition.jsonl", ".truth.jsonl"
"""Suffixes of the side files, which replace the recording's."""

FORMAT = 1
"""Format version of both files, stored in their first lines."""

_MAX_POSITION = 1e-3 * MAX_POSITION  # Largest coordinate of a pose in m
_RIGID = 1e-6  # Largest deviation of a rotation matrix from a rotation
_MAX_SWEEP = 60.0  # Largest time between a frame and the time of its volume, in s
_BYTES_PER_BYTE = 10  # Memory that a side file takes for each of its bytes
_RECORDINGS = (SUFFIX, ".seq.nhdr", ".nrrd", ".nhdr", ".mha", ".mhd")


def side_path(recording: Path, suffix: str) -> Path:
    """Return the path of a recording's side file: the same name with another suffix."""
    name = recording.name
    for each in _RECORDINGS:
        if name.lower().endswith(each):
            return recording.with_name(name[: -len(each)] + suffix)
    return recording.with_name(name + suffix)


class LinesWriter(Closing):
    """Writes a JSON Lines file beside a recording; its first line gets the format version."""

    def __init__(self, recording: Path, suffix: str, first: dict[str, Any]) -> None:
        self._path = side_path(recording, suffix)
        self._partial = partial_path(recording, suffix)
        with naming(self._partial):
            self._partial.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._partial.open("a", encoding="utf-8")
        claim(self._file.fileno(), self._path, "another file")
        self._file.truncate(0)
        self.append({"format": FORMAT, **first})

    def append(self, line: dict[str, Any]) -> None:
        """Write a line."""
        with naming(self._partial):
            self._file.write(json.dumps(line) + "\n")
            self._file.flush()

    def close(self, keep: bool = True) -> None:
        """Give the file its final name, or remove it."""
        if self._file.closed:
            return
        self._file.close()
        if keep:
            os.replace(self._partial, self._path)
        else:
            self._partial.unlink()


def describe_grid(volume: Volume) -> dict[str, Any]:
    """Return the part of an acquisition that all volumes of a recording share."""
    return {
        "origin": volume.origin.tolist(),
        "spacing": volume.spacing.tolist(),
        "decibels_per_level": volume.decibels_per_level,
        "point_spread": _describe_spread(volume.point_spread),
        "geometry": asdict(volume.motion.geometry) if volume.motion else None,
    }


def _describe_spread(spread: PointSpread | None) -> dict[str, Any] | None:
    if spread is None:
        return None
    return {each.name: getattr(spread, each.name).tolist() for each in fields(spread)}


def describe_acquisition(volume: Volume) -> dict[str, Any]:
    """Return the time and poses at which a volume was acquired."""
    motion = volume.motion
    line = {"time": volume.time, "X_WP": volume.X_WP.GetAsMatrix4().tolist()}
    if motion is not None:
        line["direction"] = motion.direction
        line["frame_times"] = motion.times.tolist()
        line["frame_X_WP"] = motion.X_WP.tolist()
    return line


@dataclass(frozen=True, eq=False)
class Acquisition:
    """Exact times in s and poses X_WP of the acquisition of volumes, and a tracker's settings.

    Origin, spacing (m), dB per grey level and point spread are those of all volumes; the latter
    two, and the motion of the probe during a volume, are None if the file does not contain them.
    """

    origin: NDArray[np.float64]
    spacing: NDArray[np.float64]
    times: list[float]
    poses: list[RigidTransform]
    motions: list[SweepMotion | None]
    decibels_per_level: float | None
    point_spread: PointSpread | None
    settings: dict[str, Any]


def read_acquisition(path: Path) -> Acquisition:
    """Read the acquisition of a recording; ConfigurationError if it is damaged."""
    with refusing_failures(path, "damaged"):
        acquisition = parse_acquisition(*_read_lines(path))
        check_times(path, np.array(acquisition.times))
        return acquisition


def parse_acquisition(first: dict[str, Any], lines: Sequence[dict[str, Any]]) -> Acquisition:
    """Return the acquisition that a first line and a line for each volume describe."""
    geometry, spread = first.pop("geometry"), first.pop("point_spread", None)
    swept = SweepGeometry(**geometry) if geometry else None
    return Acquisition(
        np.array(first.pop("origin"), float),
        np.array(first.pop("spacing"), float),
        np.array([line["time"] for line in lines], float).tolist(),
        [RigidTransform(_poses(line["X_WP"])) for line in lines],
        [_motion(swept, line) for line in lines],
        _scale(first),
        PointSpread(**spread) if spread else None,
        _settings(first),
    )


def _poses(matrices: Any) -> NDArray[np.float64]:
    """Return (..., 4, 4) poses, after a check that they are plausible."""
    poses = np.array(matrices, float)
    require_homogeneous(poses, _MAX_POSITION)
    R = poses[..., :3, :3]
    rigid = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max() < _RIGID
    require(bool(rigid and (np.linalg.det(R) > 0).all()), "pose", matrices, "a rotation")
    return poses


def _settings(first: dict[str, Any]) -> dict[str, Any]:
    """Return the settings of the tracker, after a check of the one that this program writes."""
    seed = first.get("tracker_seed", 0)
    require(type(seed) is int and seed >= 0, "tracker_seed", seed, "a whole number of at least 0")
    return first


def _scale(first: dict[str, Any]) -> float | None:
    """Remove and return dB per grey level; older files hold the dynamic range of 0 to 255."""
    range_db = first.pop("dynamic_range_db", None)
    scale = first.pop("decibels_per_level", None if range_db is None else range_db / 255)
    if scale is not None:
        require_positive(decibels_per_level=scale)
    return scale


def _motion(geometry: SweepGeometry | None, line: dict[str, Any]) -> SweepMotion | None:
    if geometry is None:
        return None
    motion = SweepMotion(
        geometry, line["direction"], line["frame_times"], _poses(line["frame_X_WP"])
    )
    apart = float(np.abs(motion.times - line["time"]).max())
    require(apart <= _MAX_SWEEP, "frame_times", apart, f"within {_MAX_SWEEP:g} s of the volume's")
    return motion


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth of a simulated recording: samples at (n,) times in s; no tracker reads it."""

    times: NDArray[np.float64]
    needles: list[Needle]
    contact_force: NDArray[np.float64]
    poses: list[RigidTransform] | None = None

    def at(self, time: float) -> int:
        """Return the number of the sample nearest to a time in s."""
        return int(np.abs(self.times - time).argmin())


def read_truth(path: Path) -> Truth:
    """Read the ground truth of a recording; ConfigurationError if it is damaged."""
    with refusing_failures(path, "damaged"):
        first, lines = _read_lines(path)
        require(len(lines) > 0, "samples", 0, "at least 1")
        times = np.array([line["time"] for line in lines], float)
        check_times(path, times, "sample")
        radius, force = first["needle_radius"], [line["contact_force"] for line in lines]
        require_within("needle_radius", radius, 1e-5, 1e-2)
        needles = [_needle(line["needle"], radius) for line in lines]
        poses = None
        if "X_WP" in lines[0]:
            poses = [RigidTransform(_poses(line["X_WP"])) for line in lines]
        return Truth(times, needles, _forces(force), poses)


def _needle(points: Any, radius: float) -> Needle:
    shaft = np.array(points, float).reshape(-1, 3)
    require(bool((np.abs(shaft) <= _MAX_POSITION).all()), "needle", points, "within the room")
    return Needle(shaft, radius)


def _forces(forces: list[Any]) -> NDArray[np.float64]:
    require_not_negative(contact_force=float(np.min(np.array(forces, float))))
    require_not_negative(contact_force=float(np.max(np.array(forces, float))))
    return np.array(forces, float)


def _read_lines(path: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the first line without the version, and the others."""
    require_memory(_BYTES_PER_BYTE * path.stat().st_size, str(path), "its lines")
    with path.open("rb") as file:
        # An incomplete last line was being written when the program was killed.
        lines = [json.loads(line) for line in file if line.endswith(b"\n")]
    if not lines or not all(isinstance(line, dict) for line in lines):
        raise ConfigurationError(f"{path}: damaged: each line must be a mapping in JSON")
    first, *others = lines
    version = first.pop("format", None)
    if version != FORMAT:
        raise ConfigurationError(f"{path} has format {version}; this program reads {FORMAT}")
    return first, others
