"""Leaf system that simulates a scanner with a motorised probe."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate_port
from sonoservo.systems.signals.requirements import require_not_negative
from sonoservo.systems.signals.sweep import MotionRecord, Sweep, SweepGeometry, SweepMotion
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation.acquisition import acquire_sweep, begin_frames
from sonoservo.systems.ultrasound.simulation.errors import Reception, poses_at
from sonoservo.systems.ultrasound.simulation.frame_renderer import Frames
from sonoservo.systems.ultrasound.simulation.reaction.deformation import Deformation
from sonoservo.systems.ultrasound.simulation.rendering import GROUP, SweepRenderer
from sonoservo.systems.ultrasound.simulation.scanner_parameters import ScannerParameters
from sonoservo.systems.ultrasound.simulation.tissue import Tissue
from sonoservo.systems.ultrasound.transducer import Transducer

_NOTHING = NotFound("no sweep is complete yet")


@dataclass(frozen=True, slots=True)
class _Snapshot(Immutable):
    """Poses, needle and deformation at a frame's acquisition, and the probe's measured pose."""

    time: float
    X_WP: RigidTransform
    X_WT: RigidTransform
    needle: Needle
    measured_X_WP: RigidTransform
    deformation: Deformation | None


@dataclass(frozen=True, eq=False)
class _Snapshots(Immutable):
    """Frames of a sweep in the order of their acquisition, and the sweep's number from 0.

    The poses that the frames are labelled with are measured at their own times, unless
    ``labels`` holds others.
    """

    number: int
    frames: tuple[_Snapshot, ...] = ()
    labels: NDArray[np.float64] | None = None

    @property
    def direction(self) -> int:
        """Direction of the motor: +1 for the first sweep, towards +Z, then alternating."""
        return 1 - 2 * (self.number % 2)

    def with_frame(self, frame: _Snapshot) -> "_Snapshots":
        return _Snapshots(self.number, (*self.frames, frame), self.labels)


@dataclass(frozen=True, eq=False)
class _Progress(Immutable):
    """The sweep being acquired, the latest frames, and the sweeps that wait for their poses."""

    acquiring: _Snapshots
    latest: tuple[_Snapshot, ...]
    waiting: tuple[_Snapshots, ...]
    reception: Reception[_Snapshots]


class Scanner(LeafSystem):
    """Acquires one sweep after another while probe, tissue and needle move.

    .. pydrake_system::

        name: Scanner
        input_ports:
        - X_WP
        - X_WT
        - needle
        - true_X_WP (optional)
        - deformation (optional)
        output_ports:
        - sweep
        - motion_record

    `true_X_WP` and `X_WT` are the poses (RigidTransform) of the probe and the tissue, `needle` is a
    `Needle` in T, possibly empty, and `deformation` the tissue's `Deformation`. Every frame is
    rendered from them at the start of its acquisition. `X_WP` is the measured pose of the probe,
    which labels the frames; if `true_X_WP` is not connected, `X_WP` is the true pose too.

    `sweep` is the newest complete `Sweep`, or a `NotFound`; it is available when the sweep's last
    frame ends. Sweeps towards +Z and -Z alternate, starting with +Z. A sweep is rendered at most
    once: its frames in the background as they are acquired, if there are threads to spare and the
    sweeps before were read, the rest on demand. `motion_record` is the `MotionRecord` of the
    same sweep, or a `NotFound`; it is the truth, for logs only.

    With errors of the clock, a sweep has the scanner's stamps, and the program gives each frame the
    pose that bears the same stamp; if the scanner's clock is ahead, it waits for these poses. With
    errors of the connection, or a processing time, `sweep` is the newest sweep that the program has
    processed (see `Reception`); these times are rounded up to whole frames.

    Parameters
    ----------
    transducer, imaging
        Hardware of the probe, and settings of the scanner.
    tissue
        Tissue to scan.
    parameters
        Parameters of needle, gel, noise and errors.
    seed
        Seed of the noise, of the needle's surface and of the errors.
    processing_time
        Time in s for which a program that takes the sweeps is busy with each; 0 shows them all.

    Attributes
    ----------
    geometry
        Geometry of the sweeps.
    """

    def __init__(
        self,
        *,
        transducer: Transducer,
        imaging: ImagingParameters,
        tissue: Tissue,
        parameters: ScannerParameters,
        seed: int,
        processing_time: float = 0.0,
    ) -> None:
        super().__init__()
        require_not_negative(processing_time=processing_time)
        self._renderer = SweepRenderer(
            transducer=transducer,
            imaging=imaging,
            tissue=tissue,
            parameters=parameters,
            seed=seed,
        )
        self.geometry: SweepGeometry = self._renderer.geometry
        # The framework marks all state as changed at every event, but a sweep is immutable.
        self._rendered = lru_cache(maxsize=2)(self._render)
        self._motions = lru_cache(maxsize=2)(self._find_motions)
        self._X_WP = self.DeclareAbstractInputPort("X_WP", Value(RigidTransform()))
        self._X_WT = self.DeclareAbstractInputPort("X_WT", Value(RigidTransform()))
        declare_inputs(self, needle=Needle, deformation=Deformation)
        self._needle, self._deformation = map(self.GetInputPort, ("needle", "deformation"))
        self._true_X_WP = self.DeclareAbstractInputPort("true_X_WP", Value(RigidTransform()))
        self._parameters, self._seed, self._processing_time = parameters, seed, processing_time
        ahead = math.ceil(abs(parameters.clock.offset) / self.geometry.frame_period)
        self._kept = self.geometry.frames + 2 * ahead + 2
        start = _Progress(_Snapshots(0), (), (), Reception())
        self._progress = self.DeclareAbstractState(Value[object](start))
        read = {self.abstract_state_ticket(self._progress)}
        declare_output(self, "sweep", (Sweep, NotFound), self._calc_sweep, read)
        declare_output(
            self, "motion_record", (MotionRecord, NotFound), self._calc_motion_record, read
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=self.geometry.frame_period, offset_sec=0.0, update=self._update_frames
        )

    @property
    def work_s(self) -> float:
        """Processor time of rendering so far, in s, in the background or not."""
        return self._renderer.work_s

    def _update_frames(self, context: Context, state: State) -> EventStatus:
        time = context.get_time()
        before: _Progress = context.get_abstract_state(self._progress).get_value()
        acquiring, waiting, reception = before.acquiring, before.waiting, before.reception
        # Copied, because an input's value changes in place.
        true = measured = RigidTransform(self._X_WP.Eval(context))
        if self._true_X_WP.HasValue(context):
            true = RigidTransform(self._true_X_WP.Eval(context))
        X_WT = RigidTransform(self._X_WT.Eval(context))
        needle = evaluate_port(self._needle, context, Needle)
        deformation = None
        if self._deformation.HasValue(context):
            deformation = evaluate_port(self._deformation, context, Deformation)
        frame = _Snapshot(time, true, X_WT, needle, measured, deformation)
        latest = (*before.latest, frame)[-self._kept :]
        if len(acquiring.frames) == self.geometry.frames:
            waiting = (*waiting, acquiring)
            acquiring = _Snapshots(acquiring.number + 1)
        while waiting and self._parameters.clock.stamp(waiting[0].frames[-1].time) <= time:
            reception = self._send(waiting[0], latest, reception)
            waiting = waiting[1:]
        acquiring = acquiring.with_frame(frame)
        self._begin(acquiring)
        progress = _Progress(acquiring, latest, waiting, reception.at(time, self._processing_time))
        state.get_mutable_abstract_state(self._progress).set_value(progress)
        return EventStatus.Succeeded()

    def _send(
        self,
        snapshots: _Snapshots,
        latest: tuple[_Snapshot, ...],
        reception: Reception[_Snapshots],
    ) -> Reception[_Snapshots]:
        """Label a sweep and send it to the program, unless it is lost."""
        clock, connection = self._parameters.clock, self._parameters.connection
        rng = np.random.default_rng([self._seed, 5, snapshots.number])
        if connection.is_lost(rng):
            return reception
        if not clock.is_right:
            stamps = clock.stamp([frame.time for frame in snapshots.frames])
            times = [frame.time for frame in latest]
            labels = poses_at(stamps, times, [frame.measured_X_WP for frame in latest])
            snapshots = replace(snapshots, labels=labels)
        return reception.sent(snapshots, latest[-1].time + connection.late(rng))

    def _calc_sweep(self, context: Context, output: AbstractValue) -> None:
        snapshots = self._processed(context)
        output.set_value(self._rendered(snapshots) if snapshots else _NOTHING)

    def _calc_motion_record(self, context: Context, output: AbstractValue) -> None:
        snapshots = self._processed(context)
        output.set_value(self._motions(snapshots) if snapshots else _NOTHING)

    def _processed(self, context: Context) -> _Snapshots | None:
        progress: _Progress = context.get_abstract_state(self._progress).get_value()
        return progress.reception.processed

    def _find_motions(self, snapshots: _Snapshots) -> MotionRecord:
        # Frames are numbered towards +Z, whichever way the motor went.
        direction = snapshots.direction
        frames = snapshots.frames[::direction]
        times = np.array([frame.time for frame in frames])
        true = np.array([frame.X_WP.GetAsMatrix4() for frame in frames])
        if snapshots.labels is None:
            labels = np.array([frame.measured_X_WP.GetAsMatrix4() for frame in frames])
        else:
            labels = snapshots.labels[::direction]
        stamps = self._parameters.clock.stamp(times)
        return MotionRecord(
            measured=SweepMotion(self.geometry, direction, stamps, labels),
            true=SweepMotion(self.geometry, direction, times, true),
        )

    def _begin(self, snapshots: _Snapshots) -> None:
        """Begin to render the newest frames if they complete a group; no result depends on it."""
        count = len(snapshots.frames)
        if count % GROUP and count < self.geometry.frames:
            return
        # A slow program will never see many of the sweeps.
        if self._processing_time > 0 or not self._renderer.may_begin:
            return
        group = (count - 1) // GROUP
        part = self._renderer.groups(snapshots.direction)[group]
        frames = self._frames(snapshots, slice(group * GROUP, count), part)
        begin_frames(self._renderer, frames, snapshots.number)

    def _frames(self, snapshots: _Snapshots, acquired: slice, part: slice) -> Frames:
        """Return some of the acquired frames, which are numbered towards +Z."""
        frames = snapshots.frames[acquired][:: snapshots.direction]
        return Frames(
            part,
            snapshots.direction,
            np.array([f.X_WT.InvertAndCompose(f.X_WP).GetAsMatrix4() for f in frames]),
            np.array([frame.time for frame in frames]),
            [frame.needle for frame in frames],
            [frame.deformation for frame in frames if frame.deformation is not None] or None,
        )

    def _render(self, snapshots: _Snapshots) -> Sweep:
        motions, everything = self._motions(snapshots), slice(0, len(snapshots.frames))
        frames = self._frames(snapshots, everything, everything)
        sweep = acquire_sweep(
            self._renderer,
            motions.true,
            frames.needles,
            X_TP=frames.X_TP,
            number=snapshots.number,
            deformations=frames.deformations,
        )
        return replace(sweep, motion=motions.measured)
