"""Tracking on a live connection: the estimate for each volume is sent as soon as it is known."""

import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sonoservo.diagrams.app.interruption import is_interrupted
from sonoservo.diagrams.app.volumes.calibrate import pose_error_figures
from sonoservo.diagrams.app.volumes.estimates_table import EstimatesTable, estimate_row
from sonoservo.diagrams.needle_tracker import MakeNeedleTracker
from sonoservo.diagrams.tracker_bench import corrected_frame, track_volume
from sonoservo.diagrams.trackers.tracker_parts import TrackerParameters
from sonoservo.systems.files.writing import write_json
from sonoservo.systems.live.connection.link import Link
from sonoservo.systems.live.live_source import LiveSource
from sonoservo.systems.live.needle_sender import NeedleNames, needle_items
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.search_reason import ReasonCount
from sonoservo.systems.signals.volume import Volume

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console

_LOOK = 0.25
"""Time in s between two checks of the limits."""

_TIMED = 20_000
"""Maximum number of volumes whose delays enter the summary."""


@dataclass(frozen=True, kw_only=True)
class LiveLimits:
    """Conditions under which live tracking or recording ends by itself.

    Parameters
    ----------
    volumes
        Maximum number of volumes; None for no limit.
    patience
        Maximum time without a new volume, in s; None for no limit.
    """

    volumes: int | None = None
    patience: float | None = None

    def __post_init__(self) -> None:
        for name in ("volumes", "patience"):
            value = getattr(self, name)
            require(value is None or value > 0, name, value, "above 0")


def live_volumes(source: LiveSource, limits: LiveLimits, say: Callable[[str], None] = print) -> Any:
    """Yield the volumes of a source as they arrive, until a limit is reached."""
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
    console: "Console | None" = None,
    out: Path | None = None,
    limits: LiveLimits | None = None,
    correct_poses: bool = False,
    after_volume: Callable[[int, NeedleEstimate], None] | None = None,
    say: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Track a needle in the volumes of a live connection, until a limit or an interruption.

    Parameters
    ----------
    source
        Source of the volumes.
    parameters
        Parameters of the tracker, whose class selects it.
    seed
        Seed of every random choice; by default the one that a scanner of this package sends, or
        else 0.
    outlets
        Connections to which the estimates are sent.
    names
        Device names of the estimates.
    console
        Console that shows the volumes, if any. Its pages may end the tracking.
    out
        Folder for estimates.csv, which grows line by line, and summary.json, written at the end.
    limits
        Conditions under which tracking ends by itself.
    correct_poses
        Whether to correct delay and calibration of the poses; see `PoseCorrector`.
    after_volume
        Function called after every volume with its number and the estimate.
    say
        Function called with each line of text for the user.

    Returns
    -------
    Contents of summary.json.
    """
    names = names or NeedleNames()
    started = time.perf_counter()
    modes: Counter[str] = Counter()
    lost = ReasonCount()
    # Time in s to track a volume, and total time from its last byte to the sending of its estimate.
    track_s: deque[float] = deque(maxlen=_TIMED)
    total_s: deque[float] = deque(maxlen=_TIMED)
    tracker: Any = None
    context: Any = None
    interrupted = False
    stream = None
    if console is not None:
        console.controls.offer_buttons("stop")
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        stream = (out / "estimates.csv").open("w", newline="", encoding="utf-8")
    table = EstimatesTable(stream) if stream is not None else None
    try:
        for number, volume in enumerate(live_volumes(source, limits or LiveLimits(), say)):
            newest = source.newest
            assert newest is not None
            if tracker is None:
                noted = newest.acquisition.settings if newest.acquisition else {}
                tracker = MakeNeedleTracker(
                    correct_poses=correct_poses,
                    parameters=parameters,
                    period=1.0,
                    seed=int(noted.get("tracker_seed", 0)) if seed is None else seed,
                )
                context = tracker.CreateDefaultContext()
            began = time.perf_counter()
            estimate = track_volume(tracker, context, volume)
            ended = time.perf_counter()
            source.hold_grey_levels(bool(estimate))
            for outlet in outlets:
                outlet.send(needle_items(estimate, names, newest.image.time), topic="estimate")
            total_s.append(time.perf_counter() - newest.arrived)
            track_s.append(ended - began)
            modes[str(estimate.mode)] += 1
            if not estimate:
                lost.add(estimate.reason)
            if table is not None:
                X_WL = source.X_WL()
                if correct_poses:
                    X_WL = corrected_frame(tracker, context, volume, X_WL)
                table.append(estimate_row(number, volume, estimate, X_WL, posed=source.posed))
            if console is not None:
                console.show(volume, estimate, number + 1)
                if "stop" in console.controls.pressed():
                    break
            if after_volume is not None:
                after_volume(number, estimate)
    except KeyboardInterrupt:
        interrupted = True
    except Exception:  # compiled code may turn the interruption into an error of its own
        if not is_interrupted():
            raise
        interrupted = True
    finally:
        if stream is not None:
            stream.close()
    summary = {
        "scenario": str(source.address),
        "version": version("sonoservo"),
        "interrupted": interrupted,
        "wall_s": time.perf_counter() - started,
        "volumes": modes.total(),
        "dropped": source.dropped,
        "left_out": source.left_out.total(),
        "left_out_reasons": dict(source.left_out.most_common()),
        "poses": source.posed,
        "modes": dict(sorted(modes.items())),
        "reasons": lost.words,
        "advice": "" if modes["tracking"] else lost.advice,
        "compute_ms": {"track": _spread(track_s)},
        "latency_ms": {
            "total": _spread(total_s),
            "besides_tracking": _spread(np.subtract(total_s, track_s)),
        },
    }
    if correct_poses and tracker is not None:
        errors = tracker.GetOutputPort("pose_errors").Eval(context)
        summary["pose_errors"] = pose_error_figures(errors)
    if out is not None:
        write_json(out / "summary.json", summary)
    return summary


def _spread(seconds: Any) -> dict[str, float | None]:
    """Return the median, 99th percentile and maximum of times in s, in ms."""
    ms = 1e3 * np.array(seconds, float)
    if not len(ms):
        return {"median": None, "p99": None, "max": None}
    return {
        "median": float(np.median(ms)),
        "p99": float(np.quantile(ms, 0.99)),
        "max": float(ms.max()),
    }
