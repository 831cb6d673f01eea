"""Tracking on a live connection: the estimate for each volume is sent as soon as it is known."""

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sonoservo.diagrams.app.interruption import is_interrupted
from sonoservo.diagrams.app.options import LiveLimits
from sonoservo.diagrams.app.own_tracker import OwnTracker
from sonoservo.diagrams.app.volumes.calibrate import pose_error_figures
from sonoservo.diagrams.app.volumes.estimates_table import EstimatesTable, ModeCount, estimate_row
from sonoservo.diagrams.app.volumes.track import make_bench
from sonoservo.diagrams.tracker_bench import Sample, Sink, Tracked, TrackerBench
from sonoservo.diagrams.trackers.tracker_parts import TrackerParameters
from sonoservo.systems.files.writing import write_json
from sonoservo.systems.live.connection.link import Link
from sonoservo.systems.live.feeds import NeedleNames, needle_items
from sonoservo.systems.live.live_source import LiveSource
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.volume import Volume

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console

_LOOK = 0.25  # Time in s between two checks of the limits
_TIMED = 20_000  # Maximum number of volumes whose delays enter the summary


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


def live_samples(
    source: LiveSource, limits: LiveLimits, say: Callable[[str], None], console: "Console | None"
) -> Iterator[Sample]:
    """Yield the volumes of a connection for a bench, until a limit or the console's end."""
    for volume in live_volumes(source, limits, say):
        yield Sample(volume, source.X_WL())
        if console is not None and "stop" in console.controls.pressed():
            return


def track_live(
    source: LiveSource,
    *,
    parameters: TrackerParameters | None = None,
    tracker: OwnTracker | None = None,
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

    Estimates go to the outlets under the devices' names. The folder gets estimates.csv, which grows
    line by line, and summary.json, whose contents are returned. The seed is by default the one that
    a scanner of this package sends, or else 0. The console's pages may end the tracking.
    """
    sent, started = names or NeedleNames(), time.perf_counter()
    modes, delays = ModeCount(parameters), _Delays()
    samples = live_samples(source, limits or LiveLimits(), say, console)
    with ExitStack() as stack:
        sinks: list[Sink] = [modes]
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            stream = (out / "estimates.csv").open("w", newline="", encoding="utf-8")
            table = EstimatesTable(stack.enter_context(stream))
            sinks.append(lambda tracked: table.append(estimate_row(tracked, posed=source.posed)))

        def send(tracked: Tracked) -> None:
            newest = source.newest
            assert newest is not None
            source.hold_grey_levels(bool(tracked.estimate))
            for outlet in outlets:
                items = needle_items(tracked.estimate, sent, newest.image.time)
                outlet.send(items, topic="estimate")
            delays.add(tracked.track_s, time.perf_counter() - newest.arrived)

        sinks.insert(0, send)  # before anything that could delay the estimate
        if console is not None:
            console.controls.offer_buttons("stop")
            sinks.append(lambda each: console.show(each.volume, each.estimate, each.number + 1))
        if after_volume is not None:
            sinks.append(lambda each: after_volume(each.number, each.estimate))
        bench: TrackerBench | None = None
        try:
            first = next(samples, None)
            ended = True
            if first is not None:
                said = source.newest.acquisition if source.newest else None
                settings = said.settings if said else {}
                bench = make_bench(settings, parameters, seed, correct_poses, tracker, logged=False)
                ended = bench.run(chain([first], samples), sinks)
        except KeyboardInterrupt:
            ended = False
        except Exception:  # compiled code may turn the interruption into an error of its own
            if not is_interrupted():
                raise
            ended = False
    summary = {
        "scenario": str(source.address),
        "version": version("sonoservo"),
        "interrupted": not ended,
        "wall_s": time.perf_counter() - started,
        "dropped": source.dropped,
        "left_out": source.left_out.total(),
        "left_out_reasons": dict(source.left_out.most_common()),
        "poses": source.posed,
        "frame": "the frame of the images",
        **modes.figures(),
        **delays.figures(),
    }
    if correct_poses and bench is not None:
        summary["pose_errors"] = pose_error_figures(bench.evaluate("pose_errors"))
    if out is not None:
        write_json(out / "summary.json", summary)
    return summary


class _Delays:
    """Times in s to track a volume, and from its last byte to the sending of its estimate."""

    def __init__(self) -> None:
        self._track: deque[float] = deque(maxlen=_TIMED)
        self._total: deque[float] = deque(maxlen=_TIMED)

    def add(self, track_s: float, total_s: float) -> None:
        self._track.append(track_s)
        self._total.append(total_s)

    def figures(self) -> dict[str, Any]:
        """Return the figures of a summary, in ms."""
        return {
            "compute_ms": {"track": _spread(self._track)},
            "latency_ms": {
                "total": _spread(self._total),
                "besides_tracking": _spread(np.subtract(self._total, self._track)),
            },
        }


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
