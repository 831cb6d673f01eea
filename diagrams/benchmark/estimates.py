"""Estimates of a sequence as a table: rows that a tracker or a file of CSV gives."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.evaluation.log import columns, stack_rows
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

_AXES = "lps"
_PAIRS = [(i, j) for i in range(3) for j in range(i, 3)]
_TIP = tuple(f"tip_{axis}_mm" for axis in _AXES)
_ENTRY = tuple(f"entry_{axis}_mm" for axis in _AXES)
_COVARIANCE = tuple(f"tip_covariance_{_AXES[i]}{_AXES[j]}_mm2" for i, j in _PAIRS)

REQUIRED = ("volume", *_TIP, *_ENTRY)
OPTIONAL = ("estimate_time_s", "mode", "probability", *_COVARIANCE, "process_ms")
"""Columns of a table of estimates; others are ignored."""


@dataclass(frozen=True, eq=False)
class Estimated:
    """A tracker's estimate after one volume, in the volume's frame; falsy without a needle."""

    volume: int  # number in its file, from 0
    tip: Floats  # (3,) in P at the volume's time, in m; NaN without a needle
    entry: Floats  # (3,) other end, in P, in m
    mode: str  # found only while it is "tracking"
    time: float | None = None  # for which it holds, in s; None for the volume's
    probability: float | None = None  # stated, that it is a needle
    covariance: Floats | None = None  # (3, 3) stated, of the tip in P, in m^2
    process_ms: float | None = None  # processor time of the volume

    def __bool__(self) -> bool:
        return bool(np.isfinite(self.tip).all() and np.isfinite(self.entry).all())

    @classmethod
    def of(
        cls, number: int, volume: Volume, estimate: NeedleEstimate, process_ms: float
    ) -> "Estimated":
        """Return the row of an estimate after a volume."""
        nowhere = np.full(3, np.nan)
        if estimate.curve is None:
            probability = estimate.probability
            return cls(number, nowhere, nowhere, str(estimate.mode), None, probability, None,
                       process_ms)  # fmt: skip
        R_PW = volume.X_WP.rotation().matrix().T
        tip, entry = volume.to_probe(estimate.curve.position([1.0, 0.0]))
        return cls(
            number,
            tip,
            entry,
            str(estimate.mode),
            estimate.time,
            estimate.probability,
            R_PW @ estimate.tip_covariance @ R_PW.T,
            process_ms,
        )

    def cells(self) -> dict[str, Any]:
        """Return the row of the table, in mm; a missing number is an empty cell."""
        row: dict[str, Any] = {"volume": self.volume}
        row |= dict(zip(_TIP, 1e3 * self.tip, strict=True))
        row |= dict(zip(_ENTRY, 1e3 * self.entry, strict=True))
        row |= {"estimate_time_s": self.time, "mode": self.mode, "probability": self.probability}
        covariance = np.full((3, 3), np.nan) if self.covariance is None else 1e6 * self.covariance
        row |= {name: covariance[pair] for name, pair in zip(_COVARIANCE, _PAIRS, strict=True)}
        row["process_ms"] = self.process_ms
        missing = {name for name, each in row.items() if isinstance(each, float) and each != each}
        return {
            name: "" if each is None or name in missing
            else float(each) if isinstance(each, np.floating) else each
            for name, each in row.items()
        }  # fmt: skip


def estimates_text(rows: Sequence[Estimated]) -> str:
    """Return a table of estimates as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [*REQUIRED, *OPTIONAL], lineterminator="\n")
    writer.writeheader()
    writer.writerows(each.cells() for each in rows)
    return text.getvalue()


def parse_estimates(text: str, source: object) -> list[Estimated]:
    """Return the rows of a table of estimates; ``source`` names it in messages."""
    reader = csv.DictReader(io.StringIO(text))
    if missing := [name for name in REQUIRED if name not in (reader.fieldnames or ())]:
        raise ConfigurationError(f"{source}: the columns {', '.join(missing)} are missing")
    rows = [_parse(row, f"{source}: row {number}") for number, row in enumerate(reader, 1)]
    numbers = [each.volume for each in rows]
    if numbers != sorted(set(numbers)):
        raise ConfigurationError(f"{source}: volume: its numbers do not rise from row to row")
    return rows


def _parse(row: dict[str, str], where: str) -> Estimated:
    def number(name: str) -> float | None:
        cell = (row.get(name) or "").strip()
        try:
            value = float(cell) if cell else None
        except ValueError:
            value = np.inf
        if value is not None and not np.isfinite(value):
            raise ConfigurationError(f"{where}: {name}: {cell!r} is not a finite number")
        return value

    def vector(names: Sequence[str]) -> Floats:
        return np.array([np.nan if (x := number(name)) is None else x for name in names])

    volume = number("volume")
    if volume is None or volume < 0 or volume != int(volume):
        raise ConfigurationError(f"{where}: volume: it must be a whole number of at least 0")
    tip, entry, upper = 1e-3 * vector(_TIP), 1e-3 * vector(_ENTRY), 1e-6 * vector(_COVARIANCE)
    found = bool(np.isfinite(tip).all() and np.isfinite(entry).all())
    mode = (row.get("mode") or "").strip()
    mode = mode or str(TrackingMode.TRACKING if found else TrackingMode.SEARCHING)
    if mode not in set(TrackingMode):
        raise ConfigurationError(f"{where}: mode: {mode!r}; one of {', '.join(TrackingMode)}")
    probability = number("probability")
    if probability is not None and not 0 <= probability <= 1:
        raise ConfigurationError(f"{where}: probability: {probability} is not from 0 to 1")
    covariance = None
    if np.isfinite(upper).all():
        covariance = np.zeros((3, 3))
        for pair, value in zip(_PAIRS, upper, strict=True):
            covariance[pair] = covariance[pair[::-1]] = value
    return Estimated(
        int(volume), tip, entry, mode, number("estimate_time_s"), probability, covariance,
        number("process_ms"),
    )  # fmt: skip


def read_estimates(folder: Path, name: str) -> list[Estimated]:
    """Return the table ``NAME.csv`` of a folder; no rows if there is none."""
    path = folder / f"{name}.csv"
    try:
        return parse_estimates(path.read_text(encoding="utf-8-sig"), path)
    except FileNotFoundError:
        return []
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigurationError(f"{path}: {error}") from error


def log_of_estimates(
    truth: RunLog, volumes: Sequence[tuple[float, RigidTransform]], rows: Sequence[Estimated]
) -> RunLog:
    """Return a log without estimates with a tracker's beside it; none counts as not found."""
    by_volume = {each.volume: each for each in rows}
    kept: list[dict[str, Any]] = []
    for number, (time, X_WP) in enumerate(volumes):
        row: dict[str, Any] = {
            "volume_time": time, "volume_seen": time, "volume_estimate_time": time,
            "volume_estimate_mode": str(TrackingMode.SEARCHING),
        }  # fmt: skip
        each = by_volume.get(number)
        if each is not None:
            row["volume_estimate_mode"] = each.mode
        if each:
            R_WP = X_WP.rotation().matrix()
            row["volume_estimate_time"] = time if each.time is None else each.time
            row["volume_estimate_tip"] = X_WP.multiply(each.tip)
            row["volume_estimate_entry"] = X_WP.multiply(each.entry)
            if each.covariance is not None:
                row["volume_estimate_tip_covariance"] = R_WP @ each.covariance @ R_WP.T
        kept.append(row)
    arrays = {
        name: stack_rows(column, name, kept) if column.shape[0] == "v" else getattr(truth, name)
        for name, column in columns(RunLog).items()
    }
    return RunLog(**arrays, compute={})
