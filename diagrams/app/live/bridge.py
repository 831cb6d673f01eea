"""Bridge between live connections and recordings: record a stream, or play a file to one."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sonoservo.diagrams.app.live.track_live import live_volumes
from sonoservo.diagrams.app.options import LiveLimits
from sonoservo.diagrams.app.volumes.opening import Opened
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.live.connection.link import Link
from sonoservo.systems.live.feeds import IMAGE, volume_items
from sonoservo.systems.live.live_source import LiveSource
from sonoservo.systems.recording.recording_writer import RecordingWriter
from sonoservo.systems.recording.zea import SUFFIXES, ZeaWriter
from sonoservo.systems.signals.requirements import require_not_negative

QUEUE = 64
"""Maximum number of volumes waiting to be written; beyond it, volumes are dropped."""

_PATIENCE = 30.0


def record_live(
    source: LiveSource,
    path: Path,
    *,
    limits: LiveLimits | None = None,
    say: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Record a live connection until a limit or an interruption; return the summary.

    A stream cannot be had again, so no file is overwritten.
    """
    if path.exists():
        raise ConfigurationError(f"{path}: there is such a recording already; give another name")
    writer: RecordingWriter | ZeaWriter | None = None
    count, interrupted = 0, False
    try:
        for volume in live_volumes(source, limits or LiveLimits(), say):
            if writer is None:
                assert source.newest is not None
                said = source.newest.acquisition
                if path.suffix.lower() in SUFFIXES:
                    writer = ZeaWriter(path)
                else:
                    writer = RecordingWriter(path, said.settings if said else {})
            writer.append(volume)
            count += 1
    except KeyboardInterrupt:
        interrupted = True
    finally:
        if writer is not None:
            writer.close()
    return {
        "recording": str(path) if count else None,
        "volumes": count,
        "dropped": source.dropped,
        "left_out": source.left_out.total(),
        "left_out_reasons": dict(source.left_out.most_common()),
        "interrupted": interrupted,
    }


def play_live(
    recording: Opened,
    link: Link,
    *,
    speed: float = 1.0,
) -> dict[str, Any]:
    """Send recorded volumes as a scanner would; at speed 0, none is dropped. Return the summary."""
    require_not_negative(speed=speed)
    started = time.perf_counter()
    count, interrupted = 0, False
    try:
        for number, volume in enumerate(recording):
            if speed > 0:
                due = (recording.times[number] - recording.times[0]) / speed
                time.sleep(max(0.0, due - (time.perf_counter() - started)))
            link.send(volume_items(volume, IMAGE, recording.settings), topic="volume", keep=2)
            if speed == 0:
                link.flush(_PATIENCE)
            count += 1
    except KeyboardInterrupt:
        interrupted = True
    return {
        "recording": str(recording.path),
        "volumes": count,
        "dropped": link.dropped,
        "peers": link.peers,
        "interrupted": interrupted,
    }
