"""What a run is made of: one typed dataclass, loaded from YAML."""

from dataclasses import asdict, dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from sonoservo.diagrams.probe_controller import ProbeControllerParameters
from sonoservo.diagrams.shape_scenario import ShapeScenario
from sonoservo.diagrams.station import StationParameters
from sonoservo.diagrams.trackers.chatelain2013 import Chatelain2013TrackerParameters
from sonoservo.diagrams.trackers.registry import AnyTrackerParameters
from sonoservo.systems.control.controller_schedule import ControllerChange
from sonoservo.systems.files.typed_yaml import (
    ConfigurationError,
    assign,
    load_typed,
    read_yaml,
    suggest,
)
from sonoservo.systems.needle.insertion import InsertionParameters
from sonoservo.systems.robot.phantom_motion import PhantomMotionParameters
from sonoservo.systems.signals.requirements import require, require_positive
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.scan_converter import ScanConversionParameters
from sonoservo.systems.ultrasound.simulation.scanner import ScannerParameters


@dataclass(kw_only=True)
class Scenario:
    """All of a run. Every field has a default; a file states what differs.

    Parameters
    ----------
    name
        Of the scenario; the file's name where it came from a file.
    description
        One line for lists and reports.
    duration
        Simulated time in s.
    seed
        Of everything random: tissue, insertion, tremor, noise, sampling.
    station
        Arm, probe, phantom and their contact.
    phantom
        Tissue in the phantom: name of a file in models/phantoms, or a path.
    phantom_motion
        How the phantom is moved.
    hand
        The needle and how it is pushed.
    transducer
        Name of a file in models/transducers, or a path.
    imaging
        The scanner's settings.
    scanner
        Noise, coupling and artefacts.
    scan_conversion
        Grid of the volumes.
    tracker
        Turns volumes into the estimated needle: the kind of one of the `TRACKERS`, or its fields.
    controller
        From the estimate to the probe's motion.
    controller_changes
        What is changed of it on the way, in order of time.
    processing_time
        From the end of a sweep to the estimate that it gives, in s.
    published
        Figures of the publication that the scenario reproduces, shown beside ours.
    """

    name: str = "unnamed"
    description: str = ""
    duration: float = 30.0
    seed: int = 0
    station: StationParameters = field(default_factory=StationParameters)
    phantom: str = "agar"
    phantom_motion: PhantomMotionParameters = field(default_factory=PhantomMotionParameters)
    hand: InsertionParameters = field(default_factory=InsertionParameters)
    transducer: str = "4dc7_3_40"
    imaging: ImagingParameters = field(default_factory=ImagingParameters)
    scanner: ScannerParameters = field(default_factory=ScannerParameters)
    scan_conversion: ScanConversionParameters = field(default_factory=ScanConversionParameters)
    tracker: AnyTrackerParameters = field(default_factory=Chatelain2013TrackerParameters)
    controller: ProbeControllerParameters = field(default_factory=ProbeControllerParameters)
    controller_changes: list[ControllerChange] = field(default_factory=list)
    processing_time: float = 0.02
    published: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_positive(duration=self.duration, processing_time=self.processing_time)
        plain = self.name.strip() and not set(self.name) & set("/\\\0")
        require(bool(plain) and self.name not in (".", ".."), "name", self.name, "a plain name")
        require(self.seed >= 0, "seed", self.seed, "a whole number of at least 0")
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

    def to_yaml(self) -> str:
        """Return all fields as YAML that `load_scenario` reads."""
        return yaml.safe_dump(asdict(self), sort_keys=False)


def list_scenarios() -> dict[str, Path]:
    """Return the scenarios that come with the package: name and file."""
    folder = Path(str(files("sonoservo.diagrams"))) / "scenarios"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_scenario(
    scenario: str | Path, *, changes: list[str] | None = None, seed: int | None = None
) -> Scenario:
    """Load a scenario of the robot that follows a needle.

    Parameters
    ----------
    scenario
        The name of one that comes with the package, or a path to a YAML file.
    changes
        ``path.to.field=value`` assignments on top.
    seed
        Replaces the scenario's own.

    Raises
    ------
    ConfigurationError
        If there is no such scenario, or naming the field that is wrong, its value and what is
        allowed.
    """
    loaded = load_any_scenario(scenario, changes=changes, seed=seed)
    if not isinstance(loaded, Scenario):
        raise ConfigurationError(
            f"{scenario}: a scenario of needle shape prediction; only `sonoservo run` takes it"
        )
    return loaded


def load_any_scenario(
    scenario: str | Path, *, changes: list[str] | None = None, seed: int | None = None
) -> Scenario | ShapeScenario:
    """Load a scenario of either kind, which its field ``kind`` tells; see `load_scenario`."""
    known = list_scenarios()
    path = known.get(str(scenario), Path(scenario))
    if path.suffix not in (".yaml", ".yml"):
        raise ConfigurationError(f"unknown scenario {str(scenario)!r}; {suggest(path.name, known)}")
    data: dict[str, Any] = {"name": path.stem, **read_yaml(path)}
    for change in changes or []:
        assign(data, change)
    if seed is not None:
        data["seed"] = seed
    if "kind" in data:
        return load_typed(ShapeScenario, data, str(scenario))
    return load_typed(Scenario, data, str(scenario))
