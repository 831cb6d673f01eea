"""Choice of the valid volumes or frames of a file, with their poses and times."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.files.counting import counted
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.volume_file import MAX_POSITION, number_or_nan
from sonoservo.systems.recording.transform_chain import TransformChain
from sonoservo.systems.signals.immutable import Immutable

MAX_TIME = 1e11
"""Largest time in s; the seconds since 1970 are a hundredth of it."""

_MIN_STEP = 1e-6  # Smallest time between two volumes or frames, in s
_EPOCH = 5e8, 5e9  # Seconds since 1970 that a clock may show, in s


class Unusable(StrEnum):
    """Why volumes or frames are left out, in words that follow their number."""

    MARKED = "marked as invalid"
    NO_POSE = "without a pose"
    NO_TRANSFORM = "whose pose is no transform"
    NO_TIME = "without a time"
    OUT_OF_ORDER = "whose time breaks the order"
    EMPTY = "that hold nothing"  # known only as they are read


@dataclass(frozen=True, eq=False)
class ValidItems(Immutable):
    """Numbers, (n, 4, 4) poses in mm and times in s of what is usable; why others are not."""

    numbers: NDArray[np.int64]
    matrices: NDArray[np.float64]
    times: NDArray[np.float64]
    left_out: Mapping[Unusable, list[int]]

    def note(self, what: str) -> tuple[str, ...]:
        """Return a sentence about those that were left out, if there are any."""
        if not self.left_out:
            return ()
        reasons = (
            f"{len(numbers)} {reason} ({', '.join(map(str, numbers[:3]))}"
            + (", ..." if len(numbers) > 3 else "")
            + ")"
            for reason, numbers in self.left_out.items()
        )
        total = sum(map(len, self.left_out.values()))
        return (f"left out {counted(total, what)}: {'; '.join(reasons)}",)


def choose_items(
    path: Path,
    count: int,
    fields: Mapping[str, Mapping[int, str]],
    chain: TransformChain | None,
    constants: Mapping[str, NDArray[np.float64]],
    times: NDArray[np.float64],
    what: str = "volume",
) -> ValidItems:
    """Return the volumes or frames that are not marked as invalid, and have a pose and a time."""
    left_out: dict[Unusable, list[int]] = {}
    matrices, numbers = [], []
    names = [link.name for link in chain.links] if chain else []
    own = [name for name in names if name not in constants]
    fault, marked = "", Counter[str]()
    for k in range(count):
        marks = ["ImageStatus", *(f"{name}TransformStatus" for name in own)]
        bad = [mark for mark in marks if fields.get(mark, {}).get(k, "OK").upper() != "OK"]
        if bad:
            marked.update(bad)
            left_out.setdefault(Unusable.MARKED, []).append(k)
        elif any(k not in fields.get(f"{name}Transform", {}) for name in own):
            left_out.setdefault(Unusable.NO_POSE, []).append(k)
        else:
            try:
                found = {
                    name: constants[name]
                    if name in constants
                    else read_matrix(
                        path, f"{what} {k}: {name}Transform", fields[f"{name}Transform"][k]
                    )
                    for name in names
                }
                matrices.append(chain.matrix(found) if chain else np.eye(4))
                numbers.append(k)
            except (ConfigurationError, np.linalg.LinAlgError) as error:
                fault = fault or str(error)
                left_out.setdefault(Unusable.NO_TRANSFORM, []).append(k)
    if not numbers:
        if fault:
            raise ConfigurationError(fault)
        reasons = [f"{mark} is not OK in {bad}" for mark, bad in marked.items()]
        if lost := left_out.get(Unusable.NO_POSE):
            reasons.append(f"{len(lost)} are {Unusable.NO_POSE}")
        raise ConfigurationError(
            f"{path}: all of its {count} {what}s are invalid: {', '.join(reasons)}"
        )
    chosen, kept = np.array(numbers), rising(times[numbers])
    for k in chosen[~kept]:
        reason = Unusable.NO_TIME if np.isnan(times[k]) else Unusable.OUT_OF_ORDER
        left_out.setdefault(reason, []).append(int(k))
    if not kept.any() or 2 * np.count_nonzero(kept) < len(kept):
        raise ConfigurationError(
            f"{path}: the times of its {what}s {_fault_of_times(chosen, times[chosen], what)}; "
            "give their rate (--volume-rate)"
        )
    return ValidItems(chosen[kept], np.array(matrices)[kept], times[chosen[kept]], left_out)


def _fault_of_times(numbers: NDArray[np.int64], times: NDArray[np.float64], what: str) -> str:
    """Return what most of the (n,) times in s that cannot be used suffer from, after "they"."""
    missing, wide = np.isnan(times), np.abs(times) > MAX_TIME
    back = len(times) - np.count_nonzero(missing | wide | rising(times))
    if np.count_nonzero(missing) >= max(np.count_nonzero(wide), back):
        return "are missing" + ("" if missing.all() else f" in {missing.sum()} of {len(times)}")
    if np.count_nonzero(wide) >= back:
        first = float(times[wide][0])
        units = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
        meant = [unit for unit in units if _EPOCH[0] < units[unit] * first < _EPOCH[1]]
        unit = f", as if in {meant[0]} since 1970" if meant else ""
        return f"are out of range (+-{MAX_TIME:g} s): {first:.15g} s{unit}"
    numbers, times = numbers[~(missing | wide)], times[~(missing | wide)]
    if (times == times[0]).all():
        return f"do not rise: all are {times[0]:.15g} s"
    k = int(np.argmax(np.diff(times) < _MIN_STEP))
    return (
        f"do not rise: that of {what} {numbers[k]} is {times[k]:.15g} s, and that of "
        f"{what} {numbers[k + 1]} {times[k + 1]:.15g} s"
    )


def rising(times: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return flags of as many plausible times as possible that rise, by at least 1 us."""
    usable = np.flatnonzero(np.abs(times) <= MAX_TIME)
    ends: list[float] = []  # smallest last time of a rising series of each length
    last: list[int] = []
    before = np.full(len(times), -1)
    for k in usable.tolist():
        length = bisect_right(ends, float(times[k]) - _MIN_STEP)
        before[k] = last[length - 1] if length else -1
        ends[length : length + 1] = [float(times[k])]
        last[length : length + 1] = [k]
    kept = np.zeros(len(times), bool)
    here = last[-1] if last else -1
    while here >= 0:
        kept[here] = True
        here = int(before[here])
    return kept


def frame_times(count: int, stamps: Mapping[int, str]) -> NDArray[np.float64]:
    """Return the (count,) times in s from the fields ``Timestamp``; NaN where there is none."""
    times = np.full(count, np.nan)
    for k, stamp in stamps.items():
        if k < count:
            times[k] = number_or_nan(stamp)
    return times


def check_times(path: Path, times: NDArray[np.float64], what: str = "volume") -> None:
    """Refuse (n,) times in s of volumes or frames that are not plausible, or do not rise."""
    wrong = np.flatnonzero(~rising(times))
    if len(wrong):
        raise ConfigurationError(
            f"{path}: the time of {what} {wrong[0]}, {times[wrong[0]]:g} s, is missing, out of "
            f"range (+-{MAX_TIME:g} s), or not later than the one before"
        )


def read_matrix(path: Path, name: str, text: str) -> NDArray[np.float64]:
    """Return the (4, 4) matrix of a transform as PLUS writes it: row by row, in mm."""
    try:
        matrix = np.array(text.split(), float).reshape(4, 4)
    except ValueError:
        matrix = np.full((4, 4), np.nan)
    try:
        require_homogeneous(matrix, MAX_POSITION)
    except ValueError as error:
        turned = (matrix[:3, 3] == 0).all() and matrix[3, 3] == 1 and matrix[3, :3].any()
        cause = "; its translation is in the last row: transposed?" if turned else ""
        raise ConfigurationError(
            f"{path}: {name}: {text[:100]!r} is not a 4 x 4 matrix whose last row is 0 0 0 1, "
            f"with positions within +-{MAX_POSITION:g} mm{cause}"
        ) from error
    return matrix


def matrix_text(matrix: ArrayLike) -> str:
    """Return a matrix as PLUS writes it, exactly: `read_matrix` gives it back."""
    return " ".join(map(repr, np.asarray(matrix, float).ravel().tolist()))


def require_homogeneous(matrix: ArrayLike, max_position: float) -> None:
    """Raise ValueError unless (..., 4, 4) matrices are finite, within reach, and end in 0 0 0 1."""
    matrices = np.asarray(matrix, float)
    right = (
        matrices.shape[-2:] == (4, 4)
        and np.isfinite(matrices).all()
        and (matrices[..., 3, :] == [0, 0, 0, 1]).all()
        and (np.abs(matrices[..., :3, 3]) <= max_position).all()
    )
    if not right:
        raise ValueError(
            f"a pose is not a finite 4 x 4 matrix whose last row is 0 0 0 1, with positions within "
            f"+-{max_position:g}"
        )
