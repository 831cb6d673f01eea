"""Reaction of the tissue in a scenario of following."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from sonoservo.diagrams.assembly import load_dome_radius
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.ultrasound.simulation.reaction.deformation import Deformation
from sonoservo.systems.ultrasound.simulation.reaction.needle_drag import Drag, advance_drag
from sonoservo.systems.ultrasound.simulation.reaction.tissue_reaction import (
    TissueReaction,
    tissue_deformation,
)

_STEP = 1 / 64


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

    Parameters
    ----------
    hand
        System with the output `needle`, in T as if the tissue were at rest.
    reaction
        Reaction of the tissue.
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


def with_tissue_reaction(
    scenario: FollowingScenario, sources: Mapping[str, System]
) -> Mapping[str, System]:
    """Return sources in which the one of the needle includes the tissue's reaction.

    Parameters
    ----------
    scenario
        Scenario with the reaction. If the tissue does not react, the sources stay as they are.
    sources
        Systems that move needle and phantom, by name.
    """
    parameters = scenario.tissue_reaction
    if not parameters.acts:
        return sources
    radius = load_dome_radius(scenario.probe)
    return {
        name: MakeReactingTissue(
            hand=system, reaction=TissueReaction(parameters=parameters, dome_radius=radius)
        )
        if system.HasOutputPort("needle")
        else system
        for name, system in sources.items()
    }


def scanned_deformations(
    scenario: FollowingScenario,
    insertion: Insertion,
    times: NDArray[np.float64],
    X_TP: NDArray[np.float64],
) -> list[Deformation] | None:
    """Return the deformations of the tissue in a sweep without a run; None if it does not react.

    Parameters
    ----------
    scenario
        Scenario with the reaction, and the probe.
    insertion
        Insertion of the needle, from time 0.
    times, X_TP
        (frames,) rising times of the frames in s, and (frames, 4, 4) poses of the probe in the
        tissue.
    """
    parameters = scenario.tissue_reaction
    if not parameters.acts:
        return None
    radius = load_dome_radius(scenario.probe)
    deformations = []
    drag, now, depth = Drag(), 0.0, insertion.depth(0.0)
    for time, X in zip(times, X_TP, strict=True):
        for then in [*np.arange(now + _STEP, time, _STEP), float(time)]:
            deeper = insertion.depth(then)
            inside = depth > 0 and deeper > 0
            drag = (
                advance_drag(drag, deeper - depth, then - now, parameters.drag)
                if inside
                else Drag()
            )
            now, depth = then, deeper
        deformations.append(
            tissue_deformation(
                insertion.needle(float(time)), drag, RigidTransform(X), radius, parameters
            )
        )
    return deformations
