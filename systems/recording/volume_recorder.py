"""Leaf system that records volumes, and the ground truth beside them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.recording.recording_writer import RecordingWriter, SweepWriter
from sonoservo.systems.recording.side_files import TRUTH, LinesWriter
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.leaves import declare_looks, declare_memory
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.ports import declare_inputs, evaluate
from sonoservo.systems.signals.requirements import require_positive
from sonoservo.systems.signals.sweep import Sweep
from sonoservo.systems.signals.volume import Volume


class _Recording:
    """Files of one run, from its start until they are closed and have their final names."""

    def __init__(self, path: Path, settings: Mapping[str, Any] | None, sweeps: bool) -> None:
        self.volumes = RecordingWriter(path, settings)
        self.sweeps = SweepWriter(path) if sweeps else None
        self.truth: LinesWriter | None = None
        self.volume_time = -float("inf")
        self.closed = False

    def close(self) -> None:
        self.closed = True
        self.volumes.close()
        if self.sweeps is not None:
            self.sweeps.close()
        if self.truth is not None:
            self.truth.close(keep=self.volume_time > -float("inf"))


@dataclass
class _Run:
    """Recording of the run that a context belongs to; None until the first event that needs it."""

    recording: _Recording | None = None

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return a run without a recording: the copy of a context is a run of its own."""
        return type(self)()


class VolumeRecorder(LeafSystem):
    """Writes every new volume to a file, and the ground truth to another.

    .. pydrake_system::

        name: VolumeRecorder
        input_ports:
        - volume
        - sweep (optional)
        - X_WT (optional)
        - true_X_WP (optional)
        - needle (optional)
        - contact_force (optional)

    `volume` and `sweep` hold a `Volume` and a `Sweep`, or a `NotFound`. The truth is the true
    `Needle` in T, the pose `X_WT` of T and the contact force in N; its file is written only if all
    three are connected, with the probe's true pose, if that is. Call `close` at the end: it gives
    the files their final names.

    The recording of a run is kept in its context. A new run closes the recording of the previous
    run and replaces it under the same name. Continuing a run whose recording is closed raises a
    RuntimeError.

    Parameters
    ----------
    path
        Path of the recording, ``NAME.seq.nrrd``; the truth is ``NAME.truth.jsonl``.
    settings
        Settings that a tracker needs in addition to the volumes.
    sweeps
        Whether to record sweeps too.
    period, offset
        Period of the checks for a new volume and time of the first one, in s.
    truth_period
        Time between samples of the truth, in s.

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
        require_positive(truth_period=truth_period)
        RecordingWriter(path)  # refuses a wrong suffix before anything is simulated
        self._path, self._settings, self._sweeps = path, settings, sweeps
        self._newest: _Recording | None = None
        self._run = declare_memory(self, _Run)
        declare_inputs(
            self,
            volume=(Volume, NotFound),
            sweep=(Sweep, NotFound),
            needle=Needle,
            X_WT=RigidTransform,
            true_X_WP=RigidTransform,
            contact_force=1,
        )
        declare_looks(self, self._record, period=period, offset=offset, start=self._start)
        self.DeclarePeriodicPublishEvent(truth_period, 0.0, self._note_truth)

    def close(self) -> None:
        """Give the files their final names; without any volume, no file is left."""
        if self._newest is not None:
            self._newest.close()

    def _start(self, context: Context) -> None:
        self._run(context).recording = None

    def _recording(self, context: Context) -> _Recording:
        """Return the recording of a run, which is created by the first event that needs it."""
        run = self._run(context)
        if run.recording is None:
            self.close()
            run.recording = self._newest = _Recording(self._path, self._settings, self._sweeps)
        if run.recording.closed:
            raise RuntimeError(f"{self._path}: this recording is closed; start a new run to record")
        return run.recording

    def _record(self, context: Context) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        if not isinstance(volume, Volume):
            return
        recording = self._recording(context)
        if volume.time <= recording.volume_time:
            return
        recording.volume_time = volume.time
        recording.volumes.append(volume)
        if recording.sweeps is not None:
            sweep = evaluate(self, context, "sweep", (Sweep, NotFound))
            if isinstance(sweep, Sweep):
                recording.sweeps.append(sweep)

    def _note_truth(self, context: Context) -> None:
        ports = ("needle", "X_WT", "contact_force")
        if not all(self.GetInputPort(name).HasValue(context) for name in ports):
            return
        needle = evaluate(self, context, "needle", Needle)
        X_WT = evaluate(self, context, "X_WT", RigidTransform)
        force = float(self.GetInputPort("contact_force").Eval(context)[0])
        recording = self._recording(context)
        if recording.truth is None:
            recording.truth = LinesWriter(self._path, TRUTH, {"needle_radius": needle.radius})
        shaft = needle.transformed(X_WT).shaft
        line = {"time": context.get_time(), "needle": shaft.tolist(), "contact_force": force}
        if self.GetInputPort("true_X_WP").HasValue(context):
            X_WP = evaluate(self, context, "true_X_WP", RigidTransform)
            line["X_WP"] = X_WP.GetAsMatrix4().tolist()
        recording.truth.append(line)
