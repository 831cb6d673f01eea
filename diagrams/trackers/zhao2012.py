"""Tracker of Zhao 2012: a filter on axis and tip that uses the velocity of the tip's speckle."""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

from pydrake.systems.framework import Diagram

from sonoservo.diagrams.trackers.tracker_parts import (
    VOLUME_GATE,
    CommonTrackerParameters,
    add_tracker_parts,
)
from sonoservo.systems.signals.ports import DiagramBuilder
from sonoservo.systems.tracking.axis_tip_filter import AxisTipFilter
from sonoservo.systems.tracking.edge_velocimeter import (
    EdgeVelocimeterParameters,
    measure_edge_velocity,
)
from sonoservo.systems.tracking.needle_filter import AnyFilter, require_order
from sonoservo.systems.tracking.speckle_velocimeter import (
    SpeckleVelocimeter,
    SpeckleVelocimeterParameters,
    measure_velocity,
)
from sonoservo.systems.tracking.track_manager import TrackManager
from sonoservo.systems.tracking.volume_memory import VolumeMemory


@dataclass(kw_only=True)
class Zhao2012TrackerParameters(CommonTrackerParameters):
    """Parameters of our tracker after Zhao 2012; see `CommonTrackerParameters` for the others.

    The paper does not describe the initial detection of a needle, which follows Chatelain 2013.

    Parameters
    ----------
    kind
        "zhao2012".
    velocimeter
        Parameters of the velocimeter: by default "edge", which follows the end of the needle, as a
        steel needle's echo and the tissue rest while it slides; "speckle" is the paper's.
    filter
        Filter of the track: by default "axis_tip", the paper's.
    """

    kind: str = "zhao2012"
    velocimeter: SpeckleVelocimeterParameters | EdgeVelocimeterParameters = field(
        default_factory=EdgeVelocimeterParameters
    )
    filter: AnyFilter = field(default_factory=AxisTipFilter)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_order(self.order, self.filter)


def MakeZhao2012Tracker(
    *,
    parameters: Zhao2012TrackerParameters,
    period: float,
    offset: float = 0.0,
    seed: int = 0,
    speckle_port: bool = False,
) -> Diagram:
    """Make the tracker of Zhao 2012; see `MakeNeedleTracker`.

    Parameters
    ----------
    parameters, period, offset, seed
        See `MakeNeedleTracker`.
    speckle_port
        Whether the velocimeter has its own input port ``speckle``, for the `RadioFrequencySweep` of
        each volume; otherwise it uses the volumes.
    """
    events: dict[str, Any] = {"period": period, "offset": offset}
    builder = DiagramBuilder()
    manager = add_tracker_parts(
        builder,
        parameters=parameters,
        needle_filter=parameters.filter,
        seed=seed,
        **events,
    )
    chosen = parameters.velocimeter
    measure = (
        partial(measure_velocity, parameters=chosen)
        if isinstance(chosen, SpeckleVelocimeterParameters)
        else partial(measure_edge_velocity, parameters=chosen)
    )
    memory = VolumeMemory(same_direction=True, **events)
    velocimeter = SpeckleVelocimeter(measure=measure)
    connect_velocimeter(builder, manager, velocimeter, memory, speckle_port=speckle_port)
    return builder.Build()


def connect_velocimeter(
    builder: DiagramBuilder,
    manager: TrackManager,
    velocimeter: SpeckleVelocimeter,
    memory: VolumeMemory,
    *,
    speckle_port: bool = False,
) -> None:
    """Add a velocimeter and the memory of its previous volume, and connect them to a tracker."""
    builder.AddNamedSystem("speckle_velocimeter", velocimeter)
    builder.AddNamedSystem("speckle_memory", memory)
    volumes = builder.GetSubsystemByName(VOLUME_GATE).GetOutputPort("volume")
    if speckle_port:
        builder.ExportInput(memory.GetInputPort("volume"), "speckle")
        builder.ConnectInput("speckle", velocimeter.GetInputPort("volume"))
    else:
        for each in (memory, velocimeter):
            builder.Connect(volumes, each.GetInputPort("volume"))
    for source, port, target in (
        (memory, "previous_volume", velocimeter),
        (manager, "prediction", velocimeter),
        (velocimeter, "velocity", manager),
    ):
        builder.Connect(source.GetOutputPort(port), target.GetInputPort(port))
