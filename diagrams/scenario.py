"""What all scenarios have in common, and how they are loaded from YAML."""

from dataclasses import asdict, dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

import yaml

from sonoservo.diagrams.experiments import experiment_class
from sonoservo.systems.files.typed_yaml import (
    ConfigurationError,
    assign,
    load_typed,
    read_yaml,
    suggest,
)
from sonoservo.systems.signals.requirements import require


@dataclass(kw_only=True)
class Scenario:
    """Common head of all scenarios; each experiment adds its own fields in a subclass.

    Every field has a default; a file states what differs.

    Parameters
    ----------
    experiment
        Experiment that the scenario describes, by its name in the registry
        (`sonoservo.diagrams.experiments`). A file that leaves it out describes "following".
    name
        Name of the scenario; the file's name if it came from a file.
    description
        One line for lists and reports.
    seed
        Seed of everything random.
    published_figures
        Figures of the publication that the scenario reproduces, shown beside ours: dotted paths
        into the summary.
    """

    experiment: str = ""
    name: str = "unnamed"
    description: str = ""
    seed: int = 0
    published_figures: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        own = type(self).experiment
        require(self.experiment == own, "experiment", self.experiment, repr(own))
        plain = self.name.strip() and not set(self.name) & set("/\\\0")
        require(bool(plain) and self.name not in (".", ".."), "name", self.name, "a plain name")
        require(self.seed >= 0, "seed", self.seed, "a whole number of at least 0")

    @property
    def duration(self) -> float:
        """Simulated time in s."""
        raise NotImplementedError

    def to_yaml(self) -> str:
        """Return all fields as YAML that `load_scenario` reads."""
        return yaml.safe_dump(asdict(self), sort_keys=False)


ScenarioT = TypeVar("ScenarioT", bound=Scenario)


def list_scenarios() -> dict[str, Path]:
    """Return the scenarios that come with the package: name and file."""
    folder = Path(str(files("sonoservo.diagrams"))) / "scenarios"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_scenario(
    scenario: str | Path, *, changes: list[str] | None = None, seed: int | None = None
) -> Scenario:
    """Load a scenario of any experiment.

    Parameters
    ----------
    scenario
        The name of one that comes with the package, or a path to a YAML file.
    changes
        ``path.to.field=value`` assignments on top.
    seed
        Replaces the scenario's own.

    Returns
    -------
    The scenario, of the class that belongs to its experiment.

    Raises
    ------
    ConfigurationError
        If there is no such scenario, or naming the field that is wrong, its value and what is
        allowed.
    """
    known = list_scenarios()
    path = known.get(str(scenario), Path(scenario))
    if path.suffix not in (".yaml", ".yml"):
        raise ConfigurationError(f"unknown scenario {str(scenario)!r}; {suggest(path.name, known)}")
    data: dict[str, Any] = {"name": path.stem, **read_yaml(path)}
    for change in changes or []:
        assign(data, change)
    if seed is not None:
        data["seed"] = seed
    try:
        schema = experiment_class(data.get("experiment", "following")).scenario_class
    except ConfigurationError as error:
        raise ConfigurationError(f"{scenario}: experiment: {error}") from error
    return load_typed(schema, data, str(scenario))


def require_scenario(scenario: Scenario, wanted: type[ScenarioT]) -> ScenarioT:
    """Return a scenario that must be of a certain experiment.

    Parameters
    ----------
    scenario
        Scenario of any experiment.
    wanted
        Class of the scenarios that are possible here.

    Raises
    ------
    ConfigurationError
        If it is of another experiment.
    """
    if not isinstance(scenario, wanted):
        raise ConfigurationError(
            f"{scenario.name}: a scenario of the experiment {scenario.experiment!r}; "
            f"one of {wanted.experiment!r} is wanted here"
        )
    return scenario
