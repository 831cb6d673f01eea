"""Scene of a simulated scanner: phantom, needle and transducer, with the probe's pose as input."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from pydrake.systems.framework import Diagram, System

from sonoservo.diagrams.assembly import load_dome_radius
from sonoservo.diagrams.scenario import Scenario, draw_seeds
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.ports import DiagramBuilder
from sonoservo.systems.signals.sweep import Sweep, SweepGeometry, SweepMotion
from sonoservo.systems.ultrasound.imaging import ImagingParameters, sweep_geometry
from sonoservo.systems.ultrasound.simulation.acquisition import acquire_sweep
from sonoservo.systems.ultrasound.simulation.reaction.deformation import Deformation
from sonoservo.systems.ultrasound.simulation.reaction.tissue_reaction import (
    Drag,
    TissueReaction,
    TissueReactionParameters,
    advance_drag,
    tissue_deformation,
)
from sonoservo.systems.ultrasound.simulation.rendering import SweepRenderer
from sonoservo.systems.ultrasound.simulation.scanner import Scanner
from sonoservo.systems.ultrasound.simulation.scanner_parameters import ScannerParameters
from sonoservo.systems.ultrasound.simulation.tissue import Tissue, load_tissue
from sonoservo.systems.ultrasound.transducer import Transducer, load_transducer

_STEP = 1 / 64
"""Time step of the drag where the needle's motion is followed without a simulation, in s."""


class _Scanned(Protocol):
    """Fields of a scenario that describe what is scanned, and with what."""

    phantom: str
    probe: str
    imaging: ImagingParameters
    scanner: ScannerParameters


@dataclass(frozen=True, eq=False)
class Acquired:
    """Sweep without a simulation, with needles in T and deformations (if any) frame by frame."""

    sweep: Sweep
    needles: list[Needle]
    deformations: list[Deformation] | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Phantom, needle and scanner, in a simulation (`scanner`) or sweep by sweep (`acquire`)."""

    transducer: Transducer
    imaging: ImagingParameters
    parameters: ScannerParameters
    tissue: Tissue  # with the structures beside this needle, and its speckle
    insertion: Insertion
    seed: int  # of the scanner's noise
    reaction: TissueReactionParameters = field(default_factory=TissueReactionParameters)
    dome_radius: float = 0.0  # of the probe in m, if the tissue reacts

    @classmethod
    def of(
        cls,
        scenario: Any,
        insertion: Insertion,
        *,
        imaging: ImagingParameters | None = None,
        reaction: TissueReactionParameters | None = None,
    ) -> "Scene":
        """Return the scene of a scenario with the fields phantom, probe, imaging and scanner."""
        scanned: _Scanned = scenario
        own: Scenario = scenario
        acts = reaction is not None and reaction.acts
        return cls(
            transducer=load_transducer(scanned.probe),
            imaging=imaging or scanned.imaging,
            parameters=scanned.scanner,
            tissue=make_tissue(own, scanned.phantom, insertion),
            insertion=insertion,
            seed=draw_seeds(own).noise,
            reaction=reaction or TissueReactionParameters(),
            dome_radius=load_dome_radius(scanned.probe) if acts else 0.0,
        )

    @cached_property
    def geometry(self) -> SweepGeometry:
        """Geometry of the sweeps, as the scanner assumes it."""
        return sweep_geometry(self.transducer, self.imaging)

    @cached_property
    def renderer(self) -> SweepRenderer:
        """Renderer of the sweeps."""
        return SweepRenderer(**self._scanned())

    def scanner(self, processing_time: float = 0.0) -> Scanner:
        """Return the scanner of a simulation; ``processing_time`` is in s, see `Scanner`."""
        return Scanner(**self._scanned(), processing_time=processing_time)

    def _scanned(self) -> dict[str, Any]:
        return {
            "transducer": self.transducer,
            "imaging": self.imaging,
            "tissue": self.tissue,
            "parameters": self.parameters,
            "seed": self.seed,
        }

    def reacting(self, sources: Mapping[str, System]) -> dict[str, System]:
        """Return sources in which each source of the needle includes the tissue's reaction."""
        if not self.reaction.acts:
            return dict(sources)
        return {
            name: self._with_reaction(system) if system.HasOutputPort("needle") else system
            for name, system in sources.items()
        }

    def _with_reaction(self, hand: System) -> Diagram:
        return MakeReactingTissue(
            hand=hand,
            reaction=TissueReaction(parameters=self.reaction, dome_radius=self.dome_radius),
        )

    def acquire(
        self, motion: SweepMotion, X_TP: NDArray[np.float64] | None = None, *, number: int = 0
    ) -> Acquired:
        """Acquire one sweep without a simulation."""
        poses = motion.X_WP if X_TP is None else X_TP
        needles = [self.insertion.needle(float(time)) for time in motion.times]
        deformations = self._deformations(motion.times, poses)
        if deformations is not None:
            pairs = zip(deformations, needles, strict=True)
            needles = [each.moved_needle(needle) for each, needle in pairs]
        sweep = acquire_sweep(
            self.renderer, motion, needles, X_TP=poses, number=number, deformations=deformations
        )
        return Acquired(sweep, needles, deformations)

    def _deformations(
        self, times: NDArray[np.float64], X_TP: NDArray[np.float64]
    ) -> list[Deformation] | None:
        """Return the tissue's deformation at rising times in s and (frames, 4, 4) poses X_TP."""
        if not self.reaction.acts:
            return None
        drag, now, depth = Drag(), 0.0, self.insertion.depth(0.0)
        deformations = []
        for time, X in zip(times, X_TP, strict=True):
            for then in [*np.arange(now + _STEP, time, _STEP), float(time)]:
                deeper = self.insertion.depth(then)
                inside = depth > 0 and deeper > 0
                drag = (
                    advance_drag(drag, deeper - depth, then - now, self.reaction.drag)
                    if inside
                    else Drag()
                )
                now, depth = then, deeper
            needle = self.insertion.needle(float(time))
            pose = RigidTransform(X)
            deformations.append(
                tissue_deformation(needle, drag, pose, self.dome_radius, self.reaction)
            )
        return deformations


def MakeReactingTissue(*, hand: System, reaction: TissueReaction) -> Diagram:
    """Make a diagram of a hand that pushes a needle, and of tissue that reacts to it.

    .. pydrake_system::

        name: (the hand's)
        input_ports:
        - true_X_WP
        - X_WT
        - (those of the hand)
        output_ports:
        - needle
        - deformation
    """
    builder = DiagramBuilder()
    builder.AddNamedSystem("hand", hand)
    builder.AddNamedSystem("tissue_reaction", reaction)
    builder.Connect(hand.GetOutputPort("needle"), reaction.GetInputPort("pushed_needle"))
    for index in range(hand.num_input_ports()):
        port = hand.get_input_port(index)
        builder.ExportInput(port, port.get_name())
    for name in ("true_X_WP", "X_WT"):
        builder.ExportInput(reaction.GetInputPort(name), name)
    for name in ("needle", "deformation"):
        builder.ExportOutput(reaction.GetOutputPort(name), name)
    return builder.Build()


def make_tissue(scenario: Scenario, phantom: str, insertion: Insertion) -> Tissue:
    """Return a phantom's tissue with the layout and the speckle that a scenario's seed draws."""
    tissue = load_tissue(phantom).placed(insertion.entry, insertion.direction, scenario.seed)
    return replace(tissue, seed=draw_seeds(scenario).tissue)
