"""What the scenarios of all experiments have in common."""

from dataclasses import dataclass, field
from typing import TypeVar

from sonoservo.systems.files.typed_yaml import ConfigurationError, dump_typed
from sonoservo.systems.signals.requirements import require


@dataclass(kw_only=True)
class Scenario:
    """Common head of all scenarios; each experiment adds its own fields in a subclass.

    Every field has a default; a file states what differs.

    Parameters
    ----------
    experiment
        Name of the experiment in the registry, `EXPERIMENTS`. A file that leaves it out describes
        "following".
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
        return dump_typed(self)


ScenarioT = TypeVar("ScenarioT", bound=Scenario)


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
