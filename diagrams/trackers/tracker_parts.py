"""Parts common to the needle trackers, and their wiring."""

from dataclasses import dataclass, field
from typing import Any

from pydrake.systems.framework import DiagramBuilder

from sonoservo.systems.detection.insertion_detector import (
    InsertionDetector,
    InsertionDetectorParameters,
)
from sonoservo.systems.detection.volume_gate import VolumeGate
from sonoservo.systems.detection.volume_memory import VolumeMemory
from sonoservo.systems.detection.volume_plausibility import VolumePlausibilityParameters
from sonoservo.systems.estimation.needle_filter import NeedleFilter
from sonoservo.systems.estimation.track_manager import TrackManager
from sonoservo.systems.estimation.track_parameters import TrackParameters
from sonoservo.systems.localization.localizer_parameters import NeedleLocalizerParameters
from sonoservo.systems.localization.needle_localizer import NeedleLocalizer
from sonoservo.systems.signals.requirements import require, require_not_negative

VOLUME_GATE = "volume_gate"
"""Name of the system through which all volumes reach a tracker."""
STARTS = ("search", "anywhere")
"""Ways in which a tracker first finds a needle."""


@dataclass(kw_only=True)
class TrackerParameters:
    """Parameters of the parts common to the needle trackers.

    Parameters
    ----------
    kind
        Name of the tracker.
    order
        Number n of control points of the needle's curve: 2 for a straight needle, 3 for a bent one.
    start
        "search" to find a needle when it is pushed in; "anywhere" to look for one in the whole
        volume from the first volume on, so that the insertion need not be seen.
    look_back
        Minimum age of the volume with which the present one is compared to detect an insertion, in
        s. Chatelain 2013 compares consecutive volumes (0), in which a slow needle moves too little.
    same_direction
        Whether only sweeps in the same direction are compared. A motorised probe samples the tissue
        differently on its way back, which makes neighbouring volumes differ everywhere.
    detector, localizer
        Parameters of the detector and of the localizer.
    track
        Rules by which a track begins, continues and ends.
    plausibility
        Limits beyond which a volume is refused.
    """

    kind: str = ""
    order: int = 2
    start: str = "search"
    look_back: float = 1.8
    same_direction: bool = True
    detector: InsertionDetectorParameters = field(default_factory=InsertionDetectorParameters)
    localizer: NeedleLocalizerParameters = field(default_factory=NeedleLocalizerParameters)
    track: TrackParameters = field(default_factory=TrackParameters)
    plausibility: VolumePlausibilityParameters = field(default_factory=VolumePlausibilityParameters)

    def __post_init__(self) -> None:
        kind = type(self).kind
        require(self.kind == kind, "kind", self.kind, repr(kind))
        require(self.start in STARTS, "start", self.start, " or ".join(map(repr, STARTS)))
        require_not_negative(look_back=self.look_back)


def require_order(order: int, needle_filter: NeedleFilter[Any]) -> None:
    """Raise ValueError unless a filter supports curves of an order."""
    orders = needle_filter.orders
    names = {2: "straight", 3: "bent"}
    allowed = " or ".join(f"{each} ({names[each]})" for each in orders)
    require(order in orders, "order", order, allowed)


def add_tracker_parts(
    builder: DiagramBuilder,
    *,
    parameters: TrackerParameters,
    needle_filter: NeedleFilter[Any],
    period: float,
    offset: float,
    seed: int,
) -> TrackManager:
    """Add and connect the parts of a tracker, and export its ports.

    Parameters
    ----------
    builder
        Builder to add to.
    parameters
        Parameters of the parts.
    needle_filter
        Filter of the track manager.
    period, offset, seed
        See `MakeNeedleTracker`.

    Returns
    -------
    The track manager, for further connections.
    """
    gate = builder.AddNamedSystem(
        VOLUME_GATE, VolumeGate(parameters=parameters.plausibility, period=period, offset=offset)
    )
    memory = builder.AddNamedSystem(
        "volume_memory",
        VolumeMemory(
            look_back=parameters.look_back,
            same_direction=parameters.same_direction,
            period=period,
            offset=offset,
        ),
    )
    detector = builder.AddNamedSystem(
        "insertion_detector",
        InsertionDetector(parameters=parameters.detector, seed=seed),
    )
    localizer = builder.AddNamedSystem(
        "needle_localizer", NeedleLocalizer(parameters=parameters.localizer, seed=seed)
    )
    manager: TrackManager = builder.AddNamedSystem(
        "track_manager",
        TrackManager(
            needle_filter=needle_filter,
            parameters=parameters.track,
            order=parameters.order,
            anywhere=parameters.start == "anywhere",
            period=period,
            offset=offset,
        ),
    )
    builder.ExportInput(gate.GetInputPort("volume"), "volume")
    for each in (memory, detector, localizer, manager):
        builder.Connect(gate.GetOutputPort("volume"), each.GetInputPort("volume"))
    for source, port, target in (
        (memory, "previous_volume", detector),
        (detector, "detection", manager),
        (localizer, "measurement", manager),
        (localizer, "explanation", manager),
        (manager, "prediction", localizer),
    ):
        builder.Connect(source.GetOutputPort(port), target.GetInputPort(port))
    for port, name in (
        ("estimate", "estimate"),
        ("last_measurement", "measurement"),
        ("last_detection", "detection"),
        ("explanation", "explanation"),
    ):
        builder.ExportOutput(manager.GetOutputPort(port), name)
    builder.ExportOutput(gate.GetOutputPort("volume_check"), "volume_check")
    return manager
