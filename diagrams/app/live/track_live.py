"""A tracker on a live connection: the needle in each volume, sent on as soon as it is known."""

import csv
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.common.value import Value

from sonoservo.diagrams.app.estimates_table import estimate_row
from sonoservo.diagrams.needle_tracker import MakeNeedleTracker
from sonoservo.diagrams.trackers.tracker_parts import TrackerParameters
from sonoservo.systems.files.writing import write_json
from sonoservo.systems.live.connection.link import Link
from sonoservo.systems.live.estimate_items import NeedleNames, needle_items
from sonoservo.systems.live.live_source import LiveSource
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.volume import Volume

if TYPE_CHECKING:
    from sonoservo.systems.display.monitor.monitor import Monitor

_LOOK = 0.25
"""Time in s after which it looks whether it should end."""

_TIMED = 20_000
"""Volumes, at most, whose delays are in the summary."""


@dataclass(frozen=True, kw_only=True)
class LiveLimits:
    """When live tracking or recording ends by itself.

    Parameters
    ----------
    volumes
        After so many; None never.
    patience
        When no volume has come for so long, in s; None never.
    """

    volumes: int | None = None
    patience: float | None = None


def live_volumes(source: LiveSource, limits: LiveLimits, say: Callable[[str], None] = print) -> Any:
    """Yield the volumes of a source until a limit is reached; waits for them."""
    count, since, quiet = 0, time.perf_counter(), False
    while limits.volumes is None or count < limits.volumes:
        volume = source.take(_LOOK)
        if isinstance(volume, Volume):
            count, since, quiet = count + 1, time.perf_counter(), False
            yield volume
            continue
        waited = time.perf_counter() - since
        if limits.patience is not None and waited > limits.patience:
            say(f"{volume.reason} for {limits.patience:g} s: ending")
            return
        if waited > 5.0 and not quiet:
            quiet = True
            say(f"{volume.reason} for 5 s; waiting")


def track_live(
    source: LiveSource,
    *,
    parameters: TrackerParameters | None = None,
    seed: int | None = None,
    outlets: Sequence[Link] = (),
    names: NeedleNames | None = None,
    monitor: "Monitor | None" = None,
    out: Path | None = None,
    limits: LiveLimits | None = None,
    after_volume: Callable[[int, NeedleEstimate], None] | None = None,
    say: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Track a needle in the volumes of a live connection, until a limit or an interruption.

    Parameters
    ----------
    source
        Of the volumes.
    parameters
        Which tracker, and its parts.
    seed
        Seed of every random choice; by default what a scanner of this package says, or else 0.
    outlets
        Where the estimates are sent to.
    names
        Of their devices.
    monitor
        Where to show the volumes.
    out
        Folder for estimates.csv, which grows line by line, and at the end summary.json.
    limits
        When it ends by itself.
    after_volume
        Called after every volume, with its number and the estimate.
    say
        Called with each line for a person.

    Returns
    -------
    What summary.json holds.
    """
    names = names or NeedleNames()
    started = time.perf_counter()
    modes: Counter[str] = Counter()
    # Time in s to track a volume, and all between its last byte and the sending of its estimate.
    track_s: deque[float] = deque(maxlen=_TIMED)
    total_s: deque[float] = deque(maxlen=_TIMED)
    tracker: Any = None
    context: Any = None
    interrupted = False
    table = _Table(out / "estimates.csv") if out is not None else None
    try:
        for number, volume in enumerate(live_volumes(source, limits or LiveLimits(), say)):
            newest = source.newest
            assert newest is not None
            if tracker is None:
                noted = newest.acquisition.settings if newest.acquisition else {}
                tracker = MakeNeedleTracker(
                    parameters=parameters,
                    period=1.0,
                    seed=int(noted.get("tracker_seed", 0)) if seed is None else seed,
                )
                context = tracker.CreateDefaultContext()
            began = time.perf_counter()
            context.SetTime(volume.time)
            tracker.GetInputPort("volume").FixValue(context, Value[object](volume))
            tracker.ExecuteForcedEvents(context)
            estimate: NeedleEstimate = tracker.GetOutputPort("estimate").Eval(context)
            ended = time.perf_counter()
            for outlet in outlets:
                outlet.send(needle_items(estimate, names, newest.image.time), topic="estimate")
            total_s.append(time.perf_counter() - newest.arrived)
            track_s.append(ended - began)
            modes[str(estimate.mode)] += 1
            if table is not None:
                X_WL = source.X_WL()
                table.append(estimate_row(number, volume, estimate, X_WL, posed=source.posed))
            if monitor is not None:
                monitor.show(volume, estimate, number + 1)
            if after_volume is not None:
                after_volume(number, estimate)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        if table is not None:
            table.close()
    summary = {
        "scenario": str(source.address),
        "version": version("sonoservo"),
        "interrupted": interrupted,
        "wall_s": time.perf_counter() - started,
        "volumes": modes.total(),
        "dropped": source.dropped,
        "left_out": source.left_out,
        "poses": source.posed,
        "modes": dict(sorted(modes.items())),
        "compute_ms": {"track": _spread(track_s)},
        "latency_ms": {
            "total": _spread(total_s),
            "besides_tracking": _spread(np.subtract(total_s, track_s)),
        },
    }
    if out is not None:
        write_json(out / "summary.json", summary)
    return summary


def _spread(seconds: Any) -> dict[str, float | None]:
    """Return median, 99 % and maximum of times, in ms."""
    ms = 1e3 * np.array(seconds, float)
    if not len(ms):
        return {"median": None, "p99": None, "max": None}
    return {
        "median": float(np.median(ms)),
        "p99": float(np.quantile(ms, 0.99)),
        "max": float(ms.max()),
    }


class _Table:
    """A file of comma-separated values that is valid after every line."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("w", newline="", encoding="utf-8")
        self._writer: csv.DictWriter[str] | None = None

    def append(self, row: dict[str, Any]) -> None:
        if self._writer is None:
            self._writer = csv.DictWriter(self._file, list(row), lineterminator="\n")
            self._writer.writeheader()
        self._writer.writerow(
            {k: "" if isinstance(v, float) and v != v else v for k, v in row.items()}
        )
        self._file.flush()

    def close(self) -> None:
        self._file.close()
