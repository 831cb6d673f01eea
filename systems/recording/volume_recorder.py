"""A system that records volumes while they come, and the truth beside them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.recording.recording_writer import RecordingWriter, SweepWriter
from sonoservo.systems.recording.side_files import TRUTH, LinesWriter
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.requirements import require_not_negative, require_positive
from sonoservo.systems.signals.sweep import Sweep
from sonoservo.systems.signals.volume import Volume


class VolumeRecorder(LeafSystem):
    """Writes every new volume to a file, and the truth to another.

    .. pydrake_system::

        name: VolumeRecorder
        input_ports:
        - volume
        - sweep (optional)
        - X_WT (optional)
        - needle (optional)
        - contact_force (optional)

    `volume` and `sweep` hold a `Volume` and a `Sweep`, or a `NotFound`. The truth is the true
    `Needle` in T, the pose `X_WT` of T and the contact force in N; without any of the three no file
    of the truth is written. Call `close` at the end: it gives the files their names.

    Parameters
    ----------
    path
        Of the recording, ``NAME.seq.nrrd``; the truth is ``NAME.truth.jsonl``.
    settings
        What a tracker has to know besides the volumes.
    sweeps
        Whether to record sweeps too.
    period, offset
        When to look for a new volume, in s.
    truth_period
        Between samples of the truth, in s.

    Raises
    ------
    ValueError
        If the path has another suffix.
    """

    def __init__(
        self,
        *,
        path: Path,
        settings: Mapping[str, Any] | None = None,
        sweeps: bool = False,
        period: float,
        offset: float = 0.0,
        truth_period: float = 1 / 32,
    ) -> None:
        super().__init__()
        require_positive(period=period, truth_period=truth_period)
        require_not_negative(offset=offset)
        self._path = path
        self._volumes = RecordingWriter(path, settings)
        self._sweeps = SweepWriter(path) if sweeps else None
        self._truth: LinesWriter | None = None
        self._volume_time = -float("inf")
        for name in ("volume", "sweep", "needle"):
            self.DeclareAbstractInputPort(name, Value[object]())
        self.DeclareAbstractInputPort("X_WT", Value(RigidTransform()))
        self.DeclareVectorInputPort("contact_force", 1)
        self.DeclarePeriodicPublishEvent(period, offset, self._record)
        self.DeclarePeriodicPublishEvent(truth_period, 0.0, self._note_truth)
        self.DeclareForcedPublishEvent(self._record)

    def close(self) -> None:
        """Give the files their final names; without any volume nothing is left."""
        recorded = self._volume_time > -float("inf")
        self._volumes.close()
        if self._sweeps is not None:
            self._sweeps.close()
        if self._truth is not None:
            self._truth.close(keep=recorded)

    def _record(self, context: Context) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        if not isinstance(volume, Volume) or volume.time <= self._volume_time:
            return
        self._volume_time = volume.time
        self._volumes.append(volume)
        if self._sweeps is not None:
            sweep = evaluate(self, context, "sweep", (Sweep, NotFound))
            if isinstance(sweep, Sweep):
                self._sweeps.append(sweep)

    def _note_truth(self, context: Context) -> None:
        ports = ("needle", "X_WT", "contact_force")
        if not all(self.GetInputPort(name).HasValue(context) for name in ports):
            return
        needle = evaluate(self, context, "needle", Needle)
        X_WT = evaluate(self, context, "X_WT", RigidTransform)
        force = float(self.GetInputPort("contact_force").Eval(context)[0])
        if self._truth is None:
            self._truth = LinesWriter(self._path, TRUTH, {"needle_radius": needle.radius})
        shaft = needle.transformed(X_WT).shaft
        self._truth.append(
            {"time": context.get_time(), "needle": shaft.tolist(), "contact_force": force}
        )
