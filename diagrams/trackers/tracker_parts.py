"""Parts common to the needle trackers, and their wiring."""

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Self

from sonoservo.systems.signals.ports import DiagramBuilder
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.tracking.line_follower import LineFollower
from sonoservo.systems.tracking.localizer_parameters import NeedleLocalizerParameters
from sonoservo.systems.tracking.needle_filter import NeedleFilter
from sonoservo.systems.tracking.needle_localizer import NeedleLocalizer
from sonoservo.systems.tracking.pipeline import explain_localization
from sonoservo.systems.tracking.track_lifecycle import TrackLifecycle
from sonoservo.systems.tracking.track_manager import TrackManager
from sonoservo.systems.tracking.track_parameters import TrackParameters
from sonoservo.systems.tracking.volume_gate import VolumeGate
from sonoservo.systems.tracking.volume_plausibility import VolumePlausibilityParameters

VOLUME_GATE = "volume_gate"
"""Name of the system through which all volumes reach a tracker."""
STARTS = ("search", "anywhere")
"""Ways in which a tracker first finds a needle."""


@dataclass(kw_only=True)
class TrackerParameters:
    """Parameters of any needle tracker.

    Parameters
    ----------
    kind
        Name of the tracker.
    order
        Number n of control points of the needle's curve: 2 for a straight needle, 3 for a bent one.
    plausibility
        Limits beyond which a volume is refused.
    """

    kind: str = ""
    order: int = 2
    plausibility: VolumePlausibilityParameters = field(default_factory=VolumePlausibilityParameters)

    def __post_init__(self) -> None:
        kind = type(self).kind
        require(self.kind == kind, "kind", self.kind, repr(kind))

    def knowing(
        self,
        *,
        start: str = "search",
        beam_width: float | None = None,
        echo_offset: float | None = None,
    ) -> Self:
        """Return the parameters with what a user knows about a recording.

        Parameters
        ----------
        start
            Way in which the needle is first found, one of the `STARTS`.
        beam_width, echo_offset
            Known values in m; see `NeedleLocalizerParameters.knowing`.

        Raises
        ------
        ValueError
            If the tracker cannot make use of it.
        """
        require(start == "search", "start", start, f"'search' with the tracker {self.kind!r}")
        for name, value in (("beam_width", beam_width), ("echo_offset", echo_offset)):
            require(value is None, name, value, f"left out with the tracker {self.kind!r}")
        return self


@dataclass(kw_only=True)
class CommonTrackerParameters(TrackerParameters):
    """Parameters of the parts that our trackers share; see `TrackerParameters` for the others.

    Parameters
    ----------
    start
        "search" to find a needle when it is pushed in; "anywhere" to look for one in the whole
        volume from the first volume on, so that the insertion need not be seen.
    localizer
        Parameters of the localizer.
    track
        Rules by which a track begins, continues and ends.
    """

    start: str = "search"
    localizer: NeedleLocalizerParameters = field(default_factory=NeedleLocalizerParameters)
    track: TrackParameters = field(default_factory=TrackParameters)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.start in STARTS, "start", self.start, " or ".join(map(repr, STARTS)))

    def knowing(
        self,
        *,
        start: str = "search",
        beam_width: float | None = None,
        echo_offset: float | None = None,
    ) -> Self:
        """Return the parameters with what a user knows; see `TrackerParameters.knowing`."""
        known = self.localizer.knowing(beam_width=beam_width, echo_offset=echo_offset)
        return replace(self, start=start, localizer=known)


def add_tracker_parts(
    builder: DiagramBuilder,
    *,
    parameters: CommonTrackerParameters,
    needle_filter: NeedleFilter[Any],
    period: float,
    offset: float,
    seed: int,
) -> TrackManager:
    """Add and connect the parts of one of our trackers, export its ports, return its manager."""
    events = {"period": period, "offset": offset}
    lifecycle = TrackLifecycle(
        order=parameters.order,
        parameters=parameters.track,
        needle_filter=needle_filter,
        anywhere=parameters.start == "anywhere",
    )
    manager = connect_parts(
        builder,
        gate=VolumeGate(parameters=parameters.plausibility, **events),
        localizer=NeedleLocalizer(
            localize=partial(explain_localization, parameters=parameters.localizer), seed=seed
        ),
        manager=TrackManager(lifecycle=lifecycle, **events),
    )
    follower = builder.AddNamedSystem(
        "line_follower",
        LineFollower(anywhere=lifecycle.anywhere, sure=parameters.track.act, **events),
    )
    gate = builder.GetSubsystemByName(VOLUME_GATE)
    builder.Connect(gate.GetOutputPort("volume"), follower.GetInputPort("volume"))
    builder.Connect(manager.GetOutputPort("estimate"), follower.GetInputPort("estimate"))
    builder.Connect(follower.GetOutputPort("lines"), manager.GetInputPort("lines"))
    builder.ExportOutput(follower.GetOutputPort("lines"), "lines")
    builder.ExportOutput(follower.GetOutputPort("explanation"), "lines_explanation")
    return manager


def connect_parts(
    builder: DiagramBuilder,
    *,
    gate: VolumeGate,
    localizer: NeedleLocalizer,
    manager: TrackManager,
) -> TrackManager:
    """Add the parts of any tracker, connect them, export its ports, and return the manager."""
    parts = {
        VOLUME_GATE: gate,
        "needle_localizer": localizer,
        "track_manager": manager,
    }
    for name, part in parts.items():
        builder.AddNamedSystem(name, part)
    builder.ExportInput(gate.GetInputPort("volume"), "volume")
    for each in (localizer, manager):
        builder.Connect(gate.GetOutputPort("volume"), each.GetInputPort("volume"))
    for source, port, target in (
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
