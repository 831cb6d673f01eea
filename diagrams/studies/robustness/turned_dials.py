"""Scenarios of the study of robustness: every dial off, or one of them turned to a strength."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
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

GRADED = load_dials()

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

CLINIC = "clinic"  # name of the scenario that has all dials at about half their moderate strength


def turned(name: str, strength: float) -> dict[str, Any]:
    """Return the settings of a case with one dial turned; see `scenario_of`."""
    dial = GRADED[name]
    if dial.phantom_field:
        phantom = {"phantom": dial.moderate["phantom"]}
        return {"changes": [], **phantom, "phantom_changes": dial.phantom_changes(strength)}
    changes = dial.changes(strength)
    if name == "speed":
        changes.append(f"hand.pushes.0.duration={PUSHED / (1e-3 * dial.quantity(strength))}")
    return {"changes": changes}


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
