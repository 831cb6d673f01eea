"""Needle trackers: diagrams that turn volumes into an estimate of the needle."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from pydrake.common.value import Value
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem

from sonoservo.systems.detection.insertion_detector import (
    InsertionDetector,
    InsertionDetectorParameters,
)
from sonoservo.systems.detection.volume_memory import VolumeMemory
from sonoservo.systems.estimation.axis_tip_filter import AxisTipFilter, AxisTipFilterParameters
from sonoservo.systems.estimation.needle_kalman_filter import (
    NeedleKalmanFilter,
    NeedleKalmanFilterParameters,
)
from sonoservo.systems.localization.localizer_parameters import NeedleLocalizerParameters
from sonoservo.systems.localization.needle_localizer import NeedleLocalizer
from sonoservo.systems.localization.speckle_velocimeter import (
    SpeckleVelocimeter,
    SpeckleVelocimeterParameters,
)
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.requirements import require, require_not_negative
from sonoservo.systems.signals.volume import Volume


@dataclass(kw_only=True)
class NeedleTrackerParameters:
    """Chatelain 2013: a Kalman filter on the needle's control points, and its parts.

    Parameters
    ----------
    kind
        "chatelain2013".
    order
        n of the needle's curve: 2 straight, 3 bent. It replaces the parts' own.
    look_back
        Least age of the volume with which the present one is compared to detect an insertion, in
        s. The paper compares consecutive volumes (0), in which a slow needle moves too little.
    same_direction
        Whether only sweeps of the same direction are compared. A motorised probe samples the
        tissue differently on its way back, so that neighbouring volumes differ everywhere.
    detector, localizer, kalman_filter
        Of the parts.
    """

    kind: str = "chatelain2013"
    order: int = 2
    look_back: float = 1.8
    same_direction: bool = True
    detector: InsertionDetectorParameters = field(default_factory=InsertionDetectorParameters)
    localizer: NeedleLocalizerParameters = field(default_factory=NeedleLocalizerParameters)
    kalman_filter: NeedleKalmanFilterParameters = field(
        default_factory=NeedleKalmanFilterParameters
    )

    def __post_init__(self) -> None:
        require(self.kind == "chatelain2013", "kind", self.kind, '"chatelain2013"')
        require(self.order in (2, 3), "order", self.order, "2 or 3")
        require_not_negative(look_back=self.look_back)
        for name in ("localizer", "kalman_filter"):
            order = getattr(self, name).order
            require(order in (2, self.order), f"{name}.order", order, "left out: order sets it")


@dataclass(kw_only=True)
class Zhao2012TrackerParameters:
    """Zhao 2012: a Kalman filter on axis, tip and the velocity of its speckle, and its parts.

    The paper does not say how a needle is found first: that is done as in Chatelain 2013.

    Parameters
    ----------
    kind
        "zhao2012".
    look_back, same_direction, detector, localizer
        See `NeedleTrackerParameters`.
    velocimeter
        Of the tip's velocity from speckle.
    axis_tip_filter
        Of the filter with eight states.
    """

    kind: str = "zhao2012"
    look_back: float = 1.8
    same_direction: bool = True
    detector: InsertionDetectorParameters = field(default_factory=InsertionDetectorParameters)
    localizer: NeedleLocalizerParameters = field(default_factory=NeedleLocalizerParameters)
    velocimeter: SpeckleVelocimeterParameters = field(default_factory=SpeckleVelocimeterParameters)
    axis_tip_filter: AxisTipFilterParameters = field(default_factory=AxisTipFilterParameters)

    def __post_init__(self) -> None:
        require(self.kind == "zhao2012", "kind", self.kind, '"zhao2012"')
        require_not_negative(look_back=self.look_back)
        order = self.localizer.order
        require(order == 2, "localizer.order", order, "2: the needle is straight")


def MakeNeedleTracker(
    *,
    parameters: NeedleTrackerParameters | Zhao2012TrackerParameters | None = None,
    period: float,
    offset: float = 0.0,
    seed: int = 0,
    speckle_port: bool = False,
) -> Diagram:
    """Make a needle tracker.

    .. pydrake_system::

        name: needle_tracker
        input_ports:
        - volume
        - speckle (optional)
        output_ports:
        - estimate
        - measurement
        - detection

    ``volume`` is a `Volume`, or a `NotFound` while there is none; ``estimate`` a `NeedleEstimate`.
    ``measurement`` and ``detection`` are those of the last update, for a log.

    Parameters
    ----------
    parameters
        Which tracker, and its parts; their class is the choice.
    period, offset
        Of the events at which it looks for a new volume, in s.
    seed
        Of every random choice.
    speckle_port
        Whether a velocimeter has an input of its own, for the `RadioFrequencySweep` of each volume;
        otherwise it looks at the volumes.
    """
    parameters = parameters or NeedleTrackerParameters()
    events = {"period": period, "offset": offset}
    builder = DiagramBuilder()
    memory = builder.AddNamedSystem(
        "volume_memory",
        VolumeMemory(
            look_back=parameters.look_back, same_direction=parameters.same_direction, **events
        ),
    )
    detector = builder.AddNamedSystem(
        "insertion_detector",
        InsertionDetector(parameters=parameters.detector, seed=seed),
    )
    localizer_parameters = parameters.localizer
    kalman_filter: NeedleKalmanFilter
    if isinstance(parameters, Zhao2012TrackerParameters):
        kalman_filter = AxisTipFilter(parameters=parameters.axis_tip_filter, **events)
    else:
        localizer_parameters = replace(localizer_parameters, order=parameters.order)
        kalman_filter = NeedleKalmanFilter(
            parameters=replace(parameters.kalman_filter, order=parameters.order), **events
        )
    localizer = builder.AddNamedSystem(
        "needle_localizer", NeedleLocalizer(parameters=localizer_parameters, seed=seed)
    )
    builder.AddNamedSystem("needle_kalman_filter", kalman_filter)
    volume = builder.ExportInput(memory.GetInputPort("volume"), "volume")
    for each in (detector, localizer, kalman_filter):
        builder.ConnectInput(volume, each.GetInputPort("volume"))
    for source, port, target in (
        (memory, "previous_volume", detector),
        (detector, "detection", kalman_filter),
        (localizer, "measurement", kalman_filter),
        (kalman_filter, "prediction", localizer),
    ):
        builder.Connect(source.GetOutputPort(port), target.GetInputPort(port))
    if isinstance(parameters, Zhao2012TrackerParameters):
        _add_velocimeter(builder, parameters, kalman_filter, events, speckle_port)
    builder.ExportOutput(kalman_filter.GetOutputPort("estimate"), "estimate")
    builder.ExportOutput(kalman_filter.GetOutputPort("last_measurement"), "measurement")
    builder.ExportOutput(kalman_filter.GetOutputPort("last_detection"), "detection")
    diagram = builder.Build()
    diagram.set_name("needle_tracker")
    return diagram


def _add_velocimeter(
    builder: DiagramBuilder,
    parameters: Zhao2012TrackerParameters,
    axis_tip_filter: LeafSystem,
    events: dict[str, float],
    speckle_port: bool,
) -> None:
    """Add what measures the tip's velocity, and the memory of the volume before."""
    velocimeter = builder.AddNamedSystem(
        "speckle_velocimeter", SpeckleVelocimeter(parameters=parameters.velocimeter)
    )
    memory = builder.AddNamedSystem(
        "speckle_memory", VolumeMemory(same_direction=parameters.same_direction, **events)
    )
    if speckle_port:
        builder.ExportInput(memory.GetInputPort("volume"), "speckle")
        builder.ConnectInput("speckle", velocimeter.GetInputPort("volume"))
    else:
        builder.ConnectInput("volume", memory.GetInputPort("volume"))
        builder.ConnectInput("volume", velocimeter.GetInputPort("volume"))
    for source, port, target in (
        (memory, "previous_volume", velocimeter),
        (axis_tip_filter, "prediction", velocimeter),
        (velocimeter, "velocity", axis_tip_filter),
    ):
        builder.Connect(source.GetOutputPort(port), target.GetInputPort(port))


def track(
    volumes: Iterable[Volume],
    *,
    parameters: NeedleTrackerParameters | Zhao2012TrackerParameters | None = None,
    seed: int = 0,
) -> Iterator[NeedleEstimate]:
    """Track a needle through volumes in order of time, without a simulation.

    Each estimate is there as soon as its volume is, so the volumes may come from a live scanner.

    Parameters
    ----------
    volumes
        From any source.
    parameters
        Of the tracker.
    seed
        Of every random choice.

    Yields
    ------
    The estimate after each volume.
    """
    # No event is ever due: one is forced for each volume.
    tracker = MakeNeedleTracker(parameters=parameters, period=1.0, seed=seed)
    context = tracker.CreateDefaultContext()
    for volume in volumes:
        tracker.GetInputPort("volume").FixValue(context, Value[object](volume))
        tracker.ExecuteForcedEvents(context)
        estimate: Any = tracker.GetOutputPort("estimate").Eval(context)
        yield estimate
