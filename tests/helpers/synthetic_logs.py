"""Logs of runs that never happened."""

from typing import Any

import numpy as np

from sonoservo.systems.evaluation import RunLog
from sonoservo.systems.evaluation.log import columns


def build_log(samples: int, volumes: int, **known: Any) -> RunLog:
    """A log in which everything is missing but what is given."""
    extents = {"n": samples, "v": volumes, "2j": 12}
    arrays = {}
    for name, column in columns(RunLog).items():
        shape = [extents.get(extent, extent) for extent in column.shape]
        fill = {"f8": np.nan, "?": False, "U": ""}[column.dtype]
        arrays[name] = np.full(shape, fill, dtype="U9" if column.dtype == "U" else column.dtype)
    return RunLog(**(arrays | known))


def build_insertion_log() -> RunLog:
    """20 s: a needle along +X of W enters at 2 s, at 5 mm/s, stops at 12 s with 50 mm inside.

    The probe looks down from above the point X = 50 mm, Y = 0. Volumes come every 0.3 s; from the
    eighth that shows 10 mm on, the estimate is the truth, 0.3 mm too far and 0.4 mm too high.
    """
    time = np.arange(0, 20, 1 / 32)
    length = np.clip(5e-3 * (time - 2), 0, 50e-3)
    inside = (length > 0)[:, np.newaxis]
    tip = np.where(inside, np.stack([length, 0 * time, 0 * time - 0.04], axis=1), np.nan)
    entry = np.where(inside, [0.0, 0.0, -0.04], np.nan)
    X_WP = np.tile(np.eye(4), (len(time), 1, 1))
    X_WP[:, :3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    X_WP[:, 0, 3] = 0.05

    volume_time = np.arange(0.15, 19.5, 0.3)
    volume_length = np.clip(5e-3 * (volume_time - 2), 0, 50e-3)
    found = volume_length >= 10e-3
    shift = [0.3e-3, 0.0, 0.4e-3]
    volume_tip = np.stack([volume_length, 0 * volume_length, 0 * volume_length - 0.04], axis=1)
    volume_tip = np.where(found[:, np.newaxis], volume_tip + shift, np.nan)
    volume_entry = np.where(found[:, np.newaxis], np.array([0, 0, -0.04]) + shift, np.nan)
    last = np.searchsorted(volume_time, time - 0.2, side="right") - 1
    known = np.where(last >= 0, found[last], False)
    force = np.where(time < 1, 0.0, 2.0)
    force[(time >= 5) & (time < 5.5)] = 0.0
    return build_log(
        len(time),
        len(volume_time),
        time=time,
        X_WP=X_WP,
        measured_X_WP=X_WP,
        X_WT=np.tile(np.eye(4), (len(time), 1, 1)),
        needle_tip=tip,
        needle_entry=entry,
        needle_points=np.linspace(entry, tip, 9, axis=1),
        inserted_length=length,
        estimate_mode=np.where(known, "tracking", "searching"),
        estimate_tip=np.where(known[:, np.newaxis], volume_tip[last], np.nan),
        estimate_entry=np.where(known[:, np.newaxis], volume_entry[last], np.nan),
        contact_force=force,
        volume_time=volume_time,
        volume_seen=volume_time + 0.2,
        volume_estimate_mode=np.where(found, "tracking", "searching"),
        volume_estimate_time=volume_time,
        volume_estimate_tip=volume_tip,
        volume_estimate_entry=volume_entry,
        compute={"track": np.array([4e-3, 5e-3, 9e-3])},
    )
