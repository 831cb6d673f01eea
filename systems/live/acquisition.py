"""The acquisition of a volume as text beside its image, for what the protocols cannot tell.

A scanner of this package sends it right before each volume, with the same time stamp. A receiver
then knows the exact grid, and when and from where each frame of the sweep was acquired; others
ignore it. It holds what the acquisition of a recording holds (`RecordingWriter`), in SI units.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from sonoservo.systems.live.connection.items import TextItem
from sonoservo.systems.recording.side_files import (
    Acquisition,
    describe_acquisition,
    describe_grid,
    parse_acquisition,
)
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.volume import Volume

NAME = "Acquisition"

_MAX_TEXT = 60000
_VOLUME = ("time", "X_WP", "direction", "frame_times", "frame_X_WP")


def acquisition_item(volume: Volume, settings: Mapping[str, Any]) -> TextItem:
    """Return the text that goes with a volume; very long sweeps are sent without their frames."""
    said = {**describe_grid(volume), **describe_acquisition(volume), **settings}
    text = json.dumps(said, separators=(",", ":"))
    if len(text) > _MAX_TEXT:
        said = {key: value for key, value in said.items() if not key.startswith("frame_")}
        text = json.dumps(said, separators=(",", ":"))
    return TextItem(NAME, volume.time, text)


def read_acquisition_item(item: TextItem) -> Acquisition:
    """Read the acquisition of one volume from a text, with the checks that one in a file passes."""
    try:
        first = json.loads(item.text)
        line = {key: first.pop(key) for key in _VOLUME if key in first}
        if "frame_X_WP" not in line:
            first["geometry"] = None
        said = parse_acquisition(first, [line])
        require(np.isfinite(said.times[0]), "time", said.times[0], "finite")
        return said
    except Exception as error:  # whatever a foreign text sets off
        raise ValueError(f"{item.name}: {' '.join(str(error).split())}") from error
