"""Logs in MCAP with Foxglove's schemas, for Foxglove and ROS 2."""

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydrake.math import RotationMatrix

from sonoservo.systems.evaluation.viewer_logs.viewer_log import (
    Colour,
    Floats,
    changes,
    ellipsoid_axes,
)
from sonoservo.systems.files.refusals import require_extra
from sonoservo.systems.signals.volume import Volume

WORLD, PROBE = "world", "probe"  # names of the frames W and P


class McapLog:
    """Writes a file ``NAME.mcap`` with Foxglove's schemas; see `ViewerLog`."""

    def __init__(self, path: Path) -> None:
        self._foxglove = require_extra("foxglove", "mcap", path)
        self._messages = m = require_extra("foxglove.messages", "mcap", path)
        self._channels = require_extra("foxglove.channels", "mcap", path)
        self._path, self._partial = path, path.with_name(f".{path.name}.part")
        path.parent.mkdir(parents=True, exist_ok=True)
        self._context = self._foxglove.Context()
        self._file = self._foxglove.open_mcap(
            str(self._partial), allow_overwrite=True, context=self._context
        )
        self._open: dict[str, Any] = {}
        self._identity = m.Quaternion(x=0, y=0, z=0, w=1)

    def poses(self, name: str, times: Floats, X_WF: Floats) -> None:
        """Write (n, 4, 4) poses of a frame in W."""
        m = self._messages
        for time, X in zip(times, X_WF, strict=True):
            if np.isfinite(X).all():
                self._write("FrameTransform", "/tf", time, m.FrameTransform(
                    timestamp=self._stamp(time), parent_frame_id=WORLD, child_frame_id=name,
                    translation=_vector(m, X[:3, 3]), rotation=_quaternion(m, X[:3, :3]),
                ))  # fmt: skip

    def lines(self, name: str, times: Floats, points: Floats, colour: Colour) -> None:
        """Write (n, m, 3) polylines; one with NaN is cleared."""
        m = self._messages
        red, green, blue = (each / 255 for each in colour)
        for time, line in zip(times, points, strict=True):
            drawn = []
            if np.isfinite(line).all():
                drawn = [m.LinePrimitive(
                    type=m.LinePrimitiveLineType.LineStrip, thickness=2.0, scale_invariant=True,
                    points=[_point(m, each) for each in line],
                    color=m.Color(r=red, g=green, b=blue, a=1.0),
                )]  # fmt: skip
            self._entity(name, time, lines=drawn)

    def ellipsoids(self, name: str, times: Floats, centres: Floats, covariances: Floats) -> None:
        """Write the ellipsoids of 95 % of (n, 3, 3) covariances in m^2; NaN clears."""
        m = self._messages
        for time, centre, covariance in zip(times, centres, covariances, strict=True):
            drawn = []
            if np.isfinite(centre).all() and np.isfinite(covariance).all():
                half, R = ellipsoid_axes(covariance)
                pose = m.Pose(position=_vector(m, centre), orientation=_quaternion(m, R))
                drawn = [m.SpherePrimitive(pose=pose, size=_vector(m, 2 * half),
                                           color=m.Color(r=1.0, g=0.6, b=0.0, a=0.4))]  # fmt: skip
            self._entity(name, time, spheres=drawn)

    def scalars(self, name: str, times: Floats, values: Floats) -> None:
        """Write (n,) numbers; NaN is left out."""
        topic = f"/{name}"
        if topic not in self._open:
            schema = {"type": "object", "properties": {"value": {"type": "number"}}}
            self._open[topic] = self._foxglove.Channel(topic, schema=schema, context=self._context)
        for time, value in zip(times, values, strict=True):
            if np.isfinite(value):
                self._open[topic].log({"value": float(value)}, log_time=_nanoseconds(time))

    def texts(self, name: str, times: Floats, texts: Sequence[str]) -> None:
        """Write texts at the times at which they change."""
        m = self._messages
        for time, text in changes(times, texts):
            self._write("Log", f"/{name}", time, m.Log(
                timestamp=self._stamp(time), level=m.LogLevel.Info, message=text, name=name,
            ))  # fmt: skip

    def image(self, name: str, time: float, grey: NDArray[np.uint8]) -> None:
        """Write (rows, columns) grey levels."""
        buffer = io.BytesIO()
        Image.fromarray(grey).save(buffer, "PNG")
        self._write("CompressedImage", f"/{name}", time, self._messages.CompressedImage(
            timestamp=self._stamp(time), frame_id=PROBE, data=buffer.getvalue(), format="png",
        ))  # fmt: skip

    def volume(self, time: float, volume: Volume) -> None:
        """Write a volume as a grid of voxels in P."""
        m = self._messages
        grey = np.rint(volume.intensities).astype(np.uint8)
        columns, rows, _ = grey.shape
        self._write("VoxelGrid", "/volume", time, m.VoxelGrid(
            timestamp=self._stamp(time), frame_id=PROBE,
            pose=m.Pose(position=_vector(m, volume.origin - 0.5 * volume.spacing),
                        orientation=self._identity),
            row_count=rows, column_count=columns, cell_size=_vector(m, volume.spacing),
            cell_stride=1, row_stride=columns, slice_stride=rows * columns,
            fields=[m.PackedElementField(name="grey", offset=0,
                                         type=m.PackedElementFieldNumericType.Uint8)],
            data=grey.transpose(2, 1, 0).tobytes(),
        ))  # fmt: skip

    def close(self) -> None:
        """Give the file its final name."""
        self._file.close()
        os.replace(self._partial, self._path)

    def _entity(self, name: str, time: float, **primitives: Any) -> None:
        m = self._messages
        stamp, frame = self._stamp(time), PROBE if name.startswith("probe/") else WORLD
        entity = m.SceneEntity(timestamp=stamp, frame_id=frame, id=name, frame_locked=True,
                               **primitives)  # fmt: skip
        self._write("SceneUpdate", f"/{name}", time, m.SceneUpdate(entities=[entity]))

    def _write(self, kind: str, topic: str, time: float, message: Any) -> None:
        if topic not in self._open:
            make = getattr(self._channels, f"{kind}Channel")
            self._open[topic] = make(topic, context=self._context)
        self._open[topic].log(message, log_time=_nanoseconds(time))

    def _stamp(self, time: float) -> Any:
        return self._messages.Timestamp(*divmod(_nanoseconds(time), 10**9))


def _nanoseconds(time: float) -> int:
    return round(1e9 * float(time))


def _vector(m: Any, v: Floats) -> Any:
    return m.Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def _point(m: Any, p: Floats) -> Any:
    return m.Point3(x=float(p[0]), y=float(p[1]), z=float(p[2]))


def _quaternion(m: Any, R: Floats) -> Any:
    w, x, y, z = RotationMatrix(np.asarray(R)).ToQuaternion().wxyz()
    return m.Quaternion(x=x, y=y, z=z, w=w)
