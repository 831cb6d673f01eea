"""The leaf that simulates a scanner with a motorised probe."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.sweep import Sweep, SweepGeometry, SweepMotion
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation.acquisition import acquire_sweep
from sonoservo.systems.ultrasound.simulation.deformation import Deformation
from sonoservo.systems.ultrasound.simulation.rendering import SweepRenderer
from sonoservo.systems.ultrasound.simulation.scanner_parameters import ScannerParameters
from sonoservo.systems.ultrasound.simulation.tissue import Tissue
from sonoservo.systems.ultrasound.transducer import Transducer


@dataclass(frozen=True, slots=True)
class _Snapshot(Immutable):
    """Poses, needle and deformation at the time of a frame's acquisition."""

    time: float
    X_WP: RigidTransform
    X_WT: RigidTransform
    needle: Needle
    deformation: Deformation | None


@dataclass(frozen=True, eq=False)
class _Snapshots(Immutable):
    """Frames of a sweep in the order of their acquisition, and the sweep's number from 0."""

    number: int
    frames: tuple[_Snapshot, ...] = ()

    @property
    def direction(self) -> int:
        """Direction of the motor: +1 for the first sweep, towards +Z, then alternating."""
        return 1 - 2 * (self.number % 2)

    def with_frame(self, frame: _Snapshot) -> "_Snapshots":
        return _Snapshots(self.number, (*self.frames, frame))


class Scanner(LeafSystem):
    """Acquires one sweep after another while probe, tissue and needle move.

    .. pydrake_system::

        name: Scanner
        input_ports:
        - X_WP
        - X_WT
        - needle
        - deformation (optional)
        output_ports:
        - sweep

    `X_WP` and `X_WT` are poses (RigidTransform) of the probe and the tissue; `needle` is a `Needle`
    in T, possibly empty; `deformation` is the tissue's `Deformation`. Every frame is rendered from
    their values at the start of its acquisition. `sweep` is the newest complete `Sweep`, or a
    `NotFound`; it is available when the sweep's last frame ends. Sweeps towards +Z and -Z
    alternate, starting with +Z. A sweep is rendered on demand, at most once.

    Parameters
    ----------
    transducer, imaging
        Hardware of the probe, and settings of the scanner.
    tissue
        Tissue to scan.
    parameters
        Parameters of needle, gel and noise.
    seed
        Seed of the noise and of the needle's surface.

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
    ) -> None:
        super().__init__()
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
        self.DeclareAbstractInputPort("X_WP", Value(RigidTransform()))
        self.DeclareAbstractInputPort("X_WT", Value(RigidTransform()))
        self.DeclareAbstractInputPort("needle", Value[object]())
        self.DeclareAbstractInputPort("deformation", Value[object]())
        self._acquiring = self.DeclareAbstractState(Value[object](_Snapshots(0)))
        self._complete = self.DeclareAbstractState(
            Value[object](NotFound("no sweep is complete yet"))
        )
        self.DeclareAbstractOutputPort(
            "sweep",
            lambda: Value[object](),
            self._calc_sweep,
            prerequisites_of_calc={self.abstract_state_ticket(self._complete)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=self.geometry.frame_period, offset_sec=0.0, update=self._update_frames
        )

    def _update_frames(self, context: Context, state: State) -> EventStatus:
        acquiring = context.get_abstract_state(self._acquiring).get_value()
        if len(acquiring.frames) == self.geometry.frames:
            state.get_mutable_abstract_state(self._complete).set_value(acquiring)
            acquiring = _Snapshots(acquiring.number + 1)
        deforms = self.GetInputPort("deformation").HasValue(context)
        frame = _Snapshot(
            context.get_time(),
            # Copied, because an input's value changes in place.
            RigidTransform(evaluate(self, context, "X_WP", RigidTransform)),
            RigidTransform(evaluate(self, context, "X_WT", RigidTransform)),
            evaluate(self, context, "needle", Needle),
            evaluate(self, context, "deformation", Deformation) if deforms else None,
        )
        state.get_mutable_abstract_state(self._acquiring).set_value(acquiring.with_frame(frame))
        return EventStatus.Succeeded()

    def _calc_sweep(self, context: Context, output: AbstractValue) -> None:
        complete = context.get_abstract_state(self._complete).get_value()
        output.set_value(self._rendered(complete) if isinstance(complete, _Snapshots) else complete)

    def _render(self, snapshots: _Snapshots) -> Sweep:
        # Frames are numbered towards +Z, whichever way the motor went.
        frames = snapshots.frames[:: snapshots.direction]
        times = np.array([frame.time for frame in frames])
        X_WP = np.array([frame.X_WP.GetAsMatrix4() for frame in frames])
        X_TP = np.array([f.X_WT.InvertAndCompose(f.X_WP).GetAsMatrix4() for f in frames])
        motion = SweepMotion(self.geometry, snapshots.direction, times, X_WP)
        needles = [frame.needle for frame in frames]
        deformations = [frame.deformation for frame in frames if frame.deformation is not None]
        return acquire_sweep(
            self._renderer,
            motion,
            needles,
            X_TP=X_TP,
            number=snapshots.number,
            deformations=deformations or None,
        )
