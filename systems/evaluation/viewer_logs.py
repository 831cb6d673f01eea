"""A run as a log for a viewer: a recording of Rerun, or MCAP for Foxglove."""

import io
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor
from pydrake.math import RotationMatrix

from sonoservo.systems.evaluation.run_errors import features
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.files.refusals import ConfigurationError, require_extra
from sonoservo.systems.signals.confidence import confidence_ellipsoid
from sonoservo.systems.signals.needle_colours import ESTIMATE, TRUTH
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.planes import sample_plane, slice_planes
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]
Grey = NDArray[np.uint8]
Colour = tuple[int, int, int]  # red, green and blue from 0 to 255

_QUIET: Colour = (150, 150, 150)

_PIXEL = 0.5e-3  # pixel size of the slices, in m


class ViewerLog(ABC):
    """A file with one time line in s of the simulation; what is named ``probe/...`` is in P."""

    def __init__(self, path: Path) -> None:
        self._path, self._partial = path, path.with_name(f".{path.name}.part")
        path.parent.mkdir(parents=True, exist_ok=True)

    @abstractmethod
    def poses(self, name: str, times: Floats, X_WF: Floats) -> None:
        """Write (n, 4, 4) poses of a frame in W."""

    def lines(self, name: str, times: Floats, points: Floats, colour: Colour) -> None:
        """Write (n, m, 3) polylines; one with NaN is cleared."""
        for time, line in zip(times.tolist(), points, strict=True):
            self._line(name, time, [line] if np.isfinite(line).all() else [], colour)

    def ellipsoids(self, name: str, times: Floats, centres: Floats, covariances: Floats) -> None:
        """Write the ellipsoids of 95 % of (n, 3, 3) covariances in m^2; NaN clears."""
        for time, centre, covariance in zip(times.tolist(), centres, covariances, strict=True):
            known = np.isfinite(centre).all() and np.isfinite(covariance).all()
            drawn = [(centre, *confidence_ellipsoid(covariance))] if known else []
            self._ellipsoid(name, time, drawn)

    @abstractmethod
    def scalars(self, name: str, times: Floats, values: Floats) -> None:
        """Write (n,) numbers; NaN is left out."""

    def texts(self, name: str, times: Floats, texts: NDArray[np.str_]) -> None:
        """Write texts at the times at which they change."""
        changed = np.flatnonzero(texts[1:] != texts[:-1]) + 1
        for k in [0, *changed.tolist()][: len(texts)]:
            self._text(name, float(times[k]), str(texts[k]))

    @abstractmethod
    def image(self, name: str, time: float, grey: Grey) -> None:
        """Write (rows, columns) grey levels."""

    @abstractmethod
    def volume(self, volume: Volume) -> None:
        """Write a volume, with the axes of P."""

    def close(self) -> None:
        """Give the file its final name."""
        self._end()
        os.replace(self._partial, self._path)

    @abstractmethod
    def _line(self, name: str, time: float, drawn: list[Floats], colour: Colour) -> None: ...

    @abstractmethod
    def _ellipsoid(
        self, name: str, time: float, drawn: list[tuple[Floats, Floats, Floats]]
    ) -> None: ...

    @abstractmethod
    def _text(self, name: str, time: float, text: str) -> None: ...

    @abstractmethod
    def _end(self) -> None: ...


class _RerunLog(ViewerLog):
    """A recording of Rerun."""

    def __init__(self, path: Path) -> None:
        self._rr = rr = require_extra("rerun", "rerun", path)
        super().__init__(path)
        self._stream = rr.RecordingStream("sonoservo")
        self._stream.save(str(self._partial))
        self._stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def poses(self, name: str, times: Floats, X_WF: Floats) -> None:
        columns = self._rr.Transform3D.columns(translation=X_WF[:, :3, 3], mat3x3=X_WF[:, :3, :3])
        self._send(f"world/{name}", times, columns)

    def scalars(self, name: str, times: Floats, values: Floats) -> None:
        known = np.isfinite(values)
        if known.any():
            self._send(name, times[known], self._rr.Scalars.columns(scalars=values[known]))

    def image(self, name: str, time: float, grey: Grey) -> None:
        self._log(name, time, self._rr.Image(grey))

    def volume(self, volume: Volume) -> None:
        grey = np.rint(volume.intensities).astype(np.uint8)
        self._log("volume", volume.time, self._rr.Tensor(grey, dim_names=("x", "y", "z")))

    def _line(self, name: str, time: float, drawn: list[Floats], colour: Colour) -> None:
        self._log(f"world/{name}", time, self._rr.LineStrips3D(drawn, colors=[colour]))

    def _ellipsoid(
        self, name: str, time: float, drawn: list[tuple[Floats, Floats, Floats]]
    ) -> None:
        centres, turns, halves = zip(*drawn, strict=True) if drawn else ((), (), ())
        shown = {"half_sizes": list(halves), "centers": list(centres)}
        if turns:
            w, *xyz = RotationMatrix(turns[0]).ToQuaternion().wxyz()
            shown["quaternions"] = [self._rr.Quaternion(xyzw=[*xyz, w])]
        self._log(f"world/{name}", time, self._rr.Ellipsoids3D(**shown))

    def _text(self, name: str, time: float, text: str) -> None:
        self._log(name, time, self._rr.TextLog(text))

    def _end(self) -> None:
        self._stream.flush()
        self._stream.disconnect()

    def _log(self, name: str, time: float, what: object) -> None:
        self._stream.set_time("time", duration=time)
        self._stream.log(name, what)

    def _send(self, name: str, times: Floats, columns: object) -> None:
        index = self._rr.TimeColumn("time", duration=np.asarray(times, float))
        self._stream.send_columns(name, indexes=[index], columns=columns)


class _McapLog(ViewerLog):
    """A file of MCAP with Foxglove's schemas."""

    def __init__(self, path: Path) -> None:
        self._foxglove = require_extra("foxglove", "mcap", path)
        self._messages = require_extra("foxglove.messages", "mcap", path)
        self._channels = require_extra("foxglove.channels", "mcap", path)
        super().__init__(path)
        self._context = self._foxglove.Context()
        self._file = self._foxglove.open_mcap(
            str(self._partial), allow_overwrite=True, context=self._context
        )
        self._open: dict[str, Any] = {}

    def poses(self, name: str, times: Floats, X_WF: Floats) -> None:
        for time, X in zip(times, X_WF, strict=True):
            if np.isfinite(X).all():
                self._write(
                    "FrameTransform", "/tf", time, parent_frame_id="world", child_frame_id=name,
                    translation=self._xyz("Vector3", X[:3, 3]), rotation=self._turn(X[:3, :3]),
                )  # fmt: skip

    def scalars(self, name: str, times: Floats, values: Floats) -> None:
        topic = f"/{name}"
        if topic not in self._open:
            schema = {"type": "object", "properties": {"value": {"type": "number"}}}
            self._open[topic] = self._foxglove.Channel(topic, schema=schema, context=self._context)
        for time, value in zip(times, values, strict=True):
            if np.isfinite(value):
                self._open[topic].log({"value": float(value)}, log_time=_nanoseconds(time))

    def image(self, name: str, time: float, grey: Grey) -> None:
        buffer = io.BytesIO()
        Image.fromarray(grey).save(buffer, "PNG")
        self._write("CompressedImage", f"/{name}", time, frame_id="probe", format="png",
                    data=buffer.getvalue())  # fmt: skip

    def volume(self, volume: Volume) -> None:
        m = self._messages
        grey = np.rint(volume.intensities).astype(np.uint8)
        columns, rows, _ = grey.shape
        corner = self._xyz("Vector3", volume.origin - 0.5 * volume.spacing)
        byte = m.PackedElementFieldNumericType.Uint8
        self._write(
            "VoxelGrid", "/volume", volume.time, frame_id="probe",
            pose=m.Pose(position=corner, orientation=m.Quaternion(x=0, y=0, z=0, w=1)),
            row_count=rows, column_count=columns, cell_size=self._xyz("Vector3", volume.spacing),
            cell_stride=1, row_stride=columns, slice_stride=rows * columns,
            fields=[m.PackedElementField(name="grey", offset=0, type=byte)],
            data=grey.transpose(2, 1, 0).tobytes(),
        )  # fmt: skip

    def _line(self, name: str, time: float, drawn: list[Floats], colour: Colour) -> None:
        m = self._messages
        red, green, blue = (each / 255 for each in colour)
        lines = [
            m.LinePrimitive(
                type=m.LinePrimitiveLineType.LineStrip, thickness=2.0, scale_invariant=True,
                points=[self._xyz("Point3", each) for each in line],
                color=m.Color(r=red, g=green, b=blue, a=1.0),
            )
            for line in drawn
        ]  # fmt: skip
        self._entity(name, time, lines=lines)

    def _ellipsoid(
        self, name: str, time: float, drawn: list[tuple[Floats, Floats, Floats]]
    ) -> None:
        m = self._messages
        spheres = [
            m.SpherePrimitive(
                pose=m.Pose(position=self._xyz("Vector3", centre), orientation=self._turn(R)),
                size=self._xyz("Vector3", 2 * half), color=m.Color(r=1.0, g=0.6, b=0.0, a=0.4),
            )
            for centre, R, half in drawn
        ]  # fmt: skip
        self._entity(name, time, spheres=spheres)

    def _text(self, name: str, time: float, text: str) -> None:
        level = self._messages.LogLevel.Info
        self._write("Log", f"/{name}", time, level=level, message=text, name=name)

    def _end(self) -> None:
        self._file.close()

    def _entity(self, name: str, time: float, **primitives: Any) -> None:
        entity = self._messages.SceneEntity(
            timestamp=self._stamp(time), id=name, frame_locked=True,
            frame_id="probe" if name.startswith("probe/") else "world", **primitives,
        )  # fmt: skip
        self._write("SceneUpdate", f"/{name}", time, entities=[entity])

    def _write(self, kind: str, topic: str, time: float, **fields: Any) -> None:
        if topic not in self._open:
            make = getattr(self._channels, f"{kind}Channel")
            self._open[topic] = make(topic, context=self._context)
        stamp = {} if kind == "SceneUpdate" else {"timestamp": self._stamp(time)}
        message = getattr(self._messages, kind)(**stamp, **fields)
        self._open[topic].log(message, log_time=_nanoseconds(time))

    def _stamp(self, time: float) -> Any:
        return self._messages.Timestamp(*divmod(_nanoseconds(time), 10**9))

    def _xyz(self, kind: str, v: Floats) -> Any:
        x, y, z = v.tolist()
        return getattr(self._messages, kind)(x=x, y=y, z=z)

    def _turn(self, R: Floats) -> Any:
        w, x, y, z = RotationMatrix(np.asarray(R)).ToQuaternion().wxyz()
        return self._messages.Quaternion(x=x, y=y, z=z, w=w)


def _nanoseconds(time: float) -> int:
    return round(1e9 * float(time))


FORMATS: dict[str, Callable[[Path], ViewerLog]] = {".rrd": _RerunLog, ".mcap": _McapLog}
"""Class of a log, by the suffix of its file."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Sector and arm of a run, which its log does not hold."""

    sector: Sequence[Floats] = ()  # edges of the swept sector in P, in m
    arm_points: Callable[[Floats], Floats] | None = None


def open_viewer_log(path: Path) -> ViewerLog:
    """Return a log for a viewer, whose format the file's suffix, one of `FORMATS`, chooses."""
    if path.suffix not in FORMATS:
        allowed = " or ".join(FORMATS)
        raise ConfigurationError(f"log: {path} is not allowed; its name must end in {allowed}")
    return FORMATS[path.suffix](path)


def write_volume(log: ViewerLog, volume: Volume, estimate: NeedleEstimate) -> None:
    """Write a volume, and the two slices through the needle in it that is estimated."""
    log.volume(volume)
    for name, plane in zip(("along", "across"), slice_planes(volume, estimate.curve), strict=False):
        log.image(f"slices/{name}", volume.time, sample_plane(volume, plane, _PIXEL))


def write_run(log: ViewerLog, run: RunLog, surroundings: Surroundings) -> None:
    """Write all that a run's log holds: arm, probe, needle, estimate, force and words."""
    time = run.time
    probed = np.isfinite(run.X_WP).all(axis=(1, 2))
    if probed.any():
        log.poses("probe", time[probed], run.X_WP[probed])
        for number, edge in enumerate(surroundings.sector):
            first = np.asarray(edge, float)[np.newaxis]
            log.lines(f"probe/sector/{number}", time[probed][:1], first, _QUIET)
    joints = run.joint_state[:, : run.joint_state.shape[1] // 2]
    moving = np.isfinite(joints).all(axis=1)
    if surroundings.arm_points is not None and moving.any():
        log.lines("arm", time[moving], surroundings.arm_points(joints[moving]), _QUIET)
    for number, position in enumerate(joints.T):
        log.scalars(f"joints/{number + 1}", time, position)
    log.lines("needle/true", time, run.needle_points, ImageColor.getrgb(TRUTH))
    estimated = np.stack([run.estimate_entry, run.estimate_tip], axis=1)
    log.lines("needle/estimated", time, estimated, ImageColor.getrgb(ESTIMATE))
    log.ellipsoids(
        "needle/doubt", run.volume_seen, run.volume_estimate_tip, run.volume_estimate_tip_covariance
    )
    log.scalars("force/contact", time, run.contact_force)
    log.scalars("force/wrist", time, np.linalg.norm(run.wrist_force[:, 3:], axis=1))
    true = features(run.X_WP, run.needle_tip, run.needle_entry)
    seen = features(run.measured_X_WP, run.estimate_tip, run.estimate_entry)
    for kind, values in (("true", true), ("estimated", seen)):
        for name, column in zip(("x", "z", "theta"), values.T, strict=True):
            log.scalars(f"features/{kind}/{name}", time, column)
    for name, column in zip(("v_x", "v_z", "omega_y"), run.planar_velocity.T, strict=True):
        log.scalars(f"command/{name}", time, column)
    log.texts("mode", time, run.estimate_mode)
    log.texts("reason/guard", time, run.guard_reason)
    log.texts("reason/hold", time, run.hold_reason)
    log.texts("reason/measurement", run.volume_seen, run.volume_measurement_reason)
