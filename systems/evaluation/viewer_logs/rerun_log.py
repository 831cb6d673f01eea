"""Logs for the viewer of Rerun."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.evaluation.viewer_logs.viewer_log import (
    Colour,
    Floats,
    changes,
    ellipsoid_axes,
)
from sonoservo.systems.files.refusals import require_extra
from sonoservo.systems.signals.volume import Volume

TIMELINE = "time"  # name of the time line, in s of the simulation


class RerunLog:
    """Writes a recording of Rerun, ``NAME.rrd``; see `ViewerLog`."""

    def __init__(self, path: Path) -> None:
        self._rr = rr = require_extra("rerun", "rerun", path)
        self._path, self._partial = path, path.with_name(f".{path.name}.part")
        path.parent.mkdir(parents=True, exist_ok=True)
        self._stream = rr.RecordingStream("sonoservo")
        self._stream.save(str(self._partial))
        self._stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def poses(self, name: str, times: Floats, X_WF: Floats) -> None:
        """Write (n, 4, 4) poses of a frame in W."""
        columns = self._rr.Transform3D.columns(translation=X_WF[:, :3, 3], mat3x3=X_WF[:, :3, :3])
        self._send(f"world/{name}", times, columns)

    def lines(self, name: str, times: Floats, points: Floats, colour: Colour) -> None:
        """Write (n, m, 3) polylines; one with NaN is cleared."""
        for time, line in zip(times, points, strict=True):
            self._stream.set_time(TIMELINE, duration=float(time))
            strips = [line] if np.isfinite(line).all() else []
            self._stream.log(f"world/{name}", self._rr.LineStrips3D(strips, colors=[colour]))

    def ellipsoids(self, name: str, times: Floats, centres: Floats, covariances: Floats) -> None:
        """Write the ellipsoids of 95 % of (n, 3, 3) covariances in m^2; NaN clears."""
        rr = self._rr
        for time, centre, covariance in zip(times, centres, covariances, strict=True):
            self._stream.set_time(TIMELINE, duration=float(time))
            if not (np.isfinite(centre).all() and np.isfinite(covariance).all()):
                self._stream.log(f"world/{name}", rr.Ellipsoids3D(half_sizes=[], centers=[]))
                continue
            half, R = ellipsoid_axes(covariance)
            turn = rr.Quaternion(xyzw=_xyzw(R))
            self._stream.log(
                f"world/{name}",
                rr.Ellipsoids3D(half_sizes=[half], centers=[centre], quaternions=[turn]),
            )

    def scalars(self, name: str, times: Floats, values: Floats) -> None:
        """Write (n,) numbers; NaN is left out."""
        known = np.isfinite(values)
        if known.any():
            self._send(name, times[known], self._rr.Scalars.columns(scalars=values[known]))

    def texts(self, name: str, times: Floats, texts: Sequence[str]) -> None:
        """Write texts at the times at which they change."""
        for time, text in changes(times, texts):
            self._stream.set_time(TIMELINE, duration=time)
            self._stream.log(name, self._rr.TextLog(text))

    def image(self, name: str, time: float, grey: NDArray[np.uint8]) -> None:
        """Write (rows, columns) grey levels."""
        self._stream.set_time(TIMELINE, duration=time)
        self._stream.log(name, self._rr.Image(grey))

    def volume(self, time: float, volume: Volume) -> None:
        """Write a volume as a tensor with the axes of P."""
        self._stream.set_time(TIMELINE, duration=time)
        grey = np.rint(volume.intensities).astype(np.uint8)
        self._stream.log("volume", self._rr.Tensor(grey, dim_names=("x", "y", "z")))

    def close(self) -> None:
        """Give the file its final name."""
        self._stream.flush()
        self._stream.disconnect()
        os.replace(self._partial, self._path)

    def _send(self, name: str, times: Floats, columns: object) -> None:
        index = self._rr.TimeColumn(TIMELINE, duration=np.asarray(times, float))
        self._stream.send_columns(name, indexes=[index], columns=columns)


def _xyzw(R: Floats) -> list[float]:
    from pydrake.math import RotationMatrix

    w, x, y, z = RotationMatrix(R).ToQuaternion().wxyz()
    return [x, y, z, w]
