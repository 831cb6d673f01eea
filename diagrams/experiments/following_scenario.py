"""Scenarios of following: a robot finds a needle and follows it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sonoservo.diagrams.assembly import PHANTOM, PROBE
from sonoservo.diagrams.probe_controller import MAX_FORCE, ProbeControllerParameters
from sonoservo.diagrams.scenario import Scenario
from sonoservo.diagrams.station import StationParameters
from sonoservo.diagrams.trackers.chatelain2013 import Chatelain2013TrackerParameters
from sonoservo.diagrams.trackers.registry import AnyTrackerParameters
from sonoservo.systems.control.controller_schedule import ControllerChange, ControllerSchedule
from sonoservo.systems.files.typed_yaml import merged
from sonoservo.systems.needle.insertion_parameters import InsertionParameters
from sonoservo.systems.robot.phantom_motion import PhantomMotionParameters
from sonoservo.systems.signals.requirements import PositiveTime, require
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.scan_converter import ScanConversionParameters
from sonoservo.systems.ultrasound.simulation.needles.needle_kind import NEEDLE
from sonoservo.systems.ultrasound.simulation.reaction.tissue_reaction import (
    TissueReactionParameters,
)
from sonoservo.systems.ultrasound.simulation.scanner_parameters import ScannerParameters

_AS_PUBLISHED = "_as_published"  # ending of the kind of a published tracker

_EQ_25 = {
    "gain": 0.8,
    "feed_forward": False,
    "held": True,
    "min_inclination_deg": 0.0,
    "stale_after": 1e3,
    "max_tip_std": 1e3,
    "max_speed": 0.1,
    "max_angular_speed_deg": 90.0,
}
"""Visual servo of Chatelain 2013, eq. 25 alone. The gain is not published: this one damps the loop
best at 3.3 volumes/s. The speeds are limited to what the robot may do at most."""


@dataclass(kw_only=True)
class FollowingScenario(Scenario):
    """Scenario of a run in which the robot follows a needle.

    Parameters
    ----------
    experiment
        Name of the experiment, "following".
    duration
        Simulated time, in s.
    station
        Arm, plant, and initial poses of probe and phantom.
    phantom
        Tissue and contact of the phantom: name of a file in models/phantoms, or a path.
    phantom_motion
        Motion of the phantom.
    tissue_reaction
        Reaction of the tissue to probe and needle.
    needle
        Kind of needle: name of a file in models/needles, or a path. It sets ``hand.gauge`` and
        ``scanner.needle`` where the scenario does not. "drawn" draws kind, gauge, rough level and
        clutter by the seed, below 100 from other kinds than above.
    hand
        Needle, and how it is pushed.
    probe
        Transducer and body of the probe: name of a file in models/probes, or a path.
    imaging
        Settings of the scanner.
    scanner
        Parameters of noise, coupling, artefacts and errors.
    scan_conversion
        Parameters of the scan conversion.
    tracker
        Tracker: the kind of one of the `TRACKERS`, or its fields.
    controller
        Controller of the probe.
    controller_changes
        Changes of the controller's settings during the run, in order of time.
    processing_time
        Time for which the tracker is busy with a volume, in s; volumes that arrive meanwhile are
        dropped, except the newest.
    """

    experiment: str = "following"
    duration: PositiveTime = 30.0
    station: StationParameters = field(default_factory=StationParameters)
    phantom: str = PHANTOM
    phantom_motion: PhantomMotionParameters = field(default_factory=PhantomMotionParameters)
    tissue_reaction: TissueReactionParameters = field(default_factory=TissueReactionParameters)
    needle: str = NEEDLE
    hand: InsertionParameters = field(default_factory=InsertionParameters)
    probe: str = PROBE
    imaging: ImagingParameters = field(default_factory=ImagingParameters)
    scanner: ScannerParameters = field(default_factory=ScannerParameters)
    scan_conversion: ScanConversionParameters = field(default_factory=ScanConversionParameters)
    tracker: AnyTrackerParameters = field(default_factory=Chatelain2013TrackerParameters)
    controller: ProbeControllerParameters = field(default_factory=ProbeControllerParameters)
    controller_changes: list[ControllerChange] = field(default_factory=list)
    processing_time: PositiveTime = 0.02

    @classmethod
    def as_published(cls, data: Mapping[str, Any]) -> dict[str, Any]:
        """Return data with the published form of its tracker, and eq. 25 as the controller."""
        tracker = data.get("tracker", {})
        tracker = {"kind": tracker} if isinstance(tracker, str) else dict(tracker)
        kind = str(tracker.get("kind", Chatelain2013TrackerParameters.kind))
        tracker["kind"] = kind.removesuffix(_AS_PUBLISHED) + _AS_PUBLISHED
        return merged({"controller": {"visual_servo": _EQ_25}}, {**data, "tracker": tracker})

    def __post_init__(self) -> None:
        super().__post_init__()
        times = [change.time for change in self.controller_changes]
        require(times == sorted(times), "controller_changes", times, "in order of time")
        touch = self.controller.force.touch_force
        for number, change in enumerate(self.controller_changes):
            require(
                change.force is None or change.force > touch,
                f"controller_changes.{number}.force",
                change.force,
                f"above controller.force.touch_force ({touch} N)",
            )
            require(
                change.force is None or change.force <= MAX_FORCE,
                f"controller_changes.{number}.force",
                change.force,
                f"at most {MAX_FORCE:g} N",
            )

    @property
    def controller_schedule(self) -> ControllerSchedule:
        """Settings of the controller over time, as planned."""
        return ControllerSchedule(self.controller.settings, tuple(self.controller_changes))
