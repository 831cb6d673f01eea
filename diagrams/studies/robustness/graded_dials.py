"""Dials of the study of robustness, their strengths, and what they change in a scenario."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from sonoservo.diagrams.dials import load_dials
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.scenario import require_scenario
from sonoservo.systems.files.model_file import model_file
from sonoservo.systems.files.typed_yaml import apply_changes, read_yaml

PUSHED = 0.05  # length of the first push in m; a faster hand pushes for less time
_SPEED = 0.008  # speed of the hand while its dial is off, in m/s

PLAIN = (
    "station.probe={x: 0.0, y: 0.0, yaw_deg: 20.0, height: 0.010}",
    "hand.entry=null",
    "hand.entry_spread=[0, 0, 0]",
    f"hand.pushes=[{{duration: {PUSHED / _SPEED}, speed: {_SPEED}}}, "
    "{duration: 3.0, speed: 0.005}]",
)
"""Changes that turn fig. 5 into the scenario in which every dial is off: the needle comes from
outside the view and passes 45 mm below the probe, which is turned by 20 deg."""


@dataclass(frozen=True)
class Turned:
    """A dial at one strength: assignments in a scenario, and changed fields of a phantom's file."""

    changes: list[str] = field(default_factory=list)
    phantom: str = ""
    phantom_changes: Mapping[str, Any] = field(default_factory=dict)

    def settings(self) -> dict[str, Any]:
        """Return the settings of a case with this dial."""
        phantom = {"phantom": self.phantom, "phantom_changes": dict(self.phantom_changes)}
        return {"changes": self.changes} | (phantom if self.phantom else {})


@dataclass(frozen=True, kw_only=True)
class GradedDial:
    """A dial of `load_dials` with the strengths at which it is studied."""

    strengths: tuple[float, ...] = (0.5, 1.0, 2.0)  # relative; empty: closed loop only
    moderate: float  # moderate strength in the dial's own unit
    unit: str  # in words; empty for a switch
    off: float = 0.0  # value of the dial's quantity at strength 0
    inverse: bool = False  # the quantity falls with the strength, as a distance does
    in_probe: bool = False  # errors count in the probe's frame, which the dial moves
    across_depth: bool = False  # errors count across the depth, which the dial stretches

    def value(self, strength: float) -> float:
        """Return the dial's quantity at a strength, in its own unit."""
        if self.inverse:
            return self.moderate / strength
        return self.off + strength * (self.moderate - self.off)

    def words(self, strength: float, unit: bool = True) -> str:
        """Return that quantity as text, with its unit or without; a switch is "on"."""
        if not self.unit:
            return "on"
        return f"{self.value(strength):.3g}{f' {self.unit}' if unit else ''}"


GRADED: Mapping[str, GradedDial] = {
    "structure beside the needle": GradedDial(
        moderate=3.0, unit="mm beside the needle's way", inverse=True
    ),
    "faint needle": GradedDial(strengths=(0.25, 0.5, 1.0), moderate=8.0, unit="dB fainter"),
    "fading needle": GradedDial(moderate=6.0, unit="dB (standard deviation)"),
    "dip": GradedDial(strengths=(0.5, 0.75, 1.0, 1.25), moderate=60.0, unit="deg"),
    "azimuth": GradedDial(strengths=(0.25, 0.5, 1.0), moderate=180.0, unit="deg to either side"),
    "speed": GradedDial(moderate=30.0, off=8.0, unit="mm/s"),
    "drag": GradedDial(strengths=(1.0, 2.0, 4.0), moderate=1.0, unit="mm"),
    "pushed aside": GradedDial(strengths=(0.5, 1.0), moderate=1.0, unit="of the needle's volume"),
    "indentation": GradedDial(strengths=(1.0,), moderate=1.0, unit=""),
    "breathing": GradedDial(strengths=(0.5, 1.0, 1.5), moderate=10.0, unit="mm peak to peak"),
    "pose delay": GradedDial(strengths=(1.0, 2.0, 4.0), moderate=50.0, unit="ms"),
    "hand-eye calibration": GradedDial(
        strengths=(1.0, 2.0, 4.0), moderate=2.0, unit="mm, and half as many deg", in_probe=True
    ),
    "probe mass": GradedDial(strengths=(), moderate=5.0, unit="%"),
    "speed of sound": GradedDial(moderate=5.0, unit="% slower", across_depth=True),
    "force bias": GradedDial(strengths=(), moderate=0.3, unit="N"),
    "lost volumes": GradedDial(strengths=(1.0, 4.0, 8.0), moderate=5.0, unit="%"),
    "backlash": GradedDial(moderate=1.0, unit="deg"),
    "air pockets": GradedDial(moderate=20.0, unit="% of the face"),
    "friction": GradedDial(strengths=(), moderate=0.2, off=0.02, unit="(coefficient)"),
}
"""Each dial of `load_dials`, by name."""

CLINIC = "clinic"  # name of the scenario that has all dials at about half their moderate strength


def turned(name: str, strength: float) -> Turned:
    """Return a dial turned to a strength, with a phantom of its own where its file has the dial."""
    dial = GRADED[name]
    value = dial.value(strength)
    if name == "structure beside the needle":
        path = "tissue.structures.0.beside_needle.distance"
        return Turned(phantom="calcified", phantom_changes={path: 1e-3 * value})
    if name == "speed of sound":
        speed = 1540.0 * (1 - value / 100)
        return Turned(phantom="slow", phantom_changes={"tissue.sound_speed": speed})
    changes = load_dials()[name].changes(strength)
    if name == "speed":
        changes.append(f"hand.pushes.0.duration={PUSHED / (1e-3 * value)}")
    return Turned(changes)


@contextmanager
def scenario_of(settings: Mapping[str, Any], seed: int) -> Iterator[FollowingScenario]:
    """Load the scenario of a case; the file of a changed phantom exists until the end."""
    with TemporaryDirectory() as folder:
        changes = list(settings["changes"])
        if settings.get("phantom"):
            data = read_yaml(model_file("phantoms", settings["phantom"]))
            apply_changes(data, dict(settings["phantom_changes"]))
            path = Path(folder) / "phantom.yaml"
            path.write_text(yaml.safe_dump(data), encoding="utf-8")
            changes.append(f"phantom={path}")
        loaded = load_scenario(settings["scenario"], changes=changes, seed=seed)
        yield require_scenario(loaded, FollowingScenario)
