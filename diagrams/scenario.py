"""Base class of the scenarios of all experiments."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np

from sonoservo.systems.files.model_file import NAMING, lasting_name
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import dump_typed
from sonoservo.systems.signals.requirements import check_bounds, require


@dataclass(kw_only=True)
class Scenario:
    """Fields common to all scenarios; each experiment adds its own in a subclass.

    Every field has a default; a file gives only the fields that differ.

    Parameters
    ----------
    experiment
        Name of the experiment in the registry, `EXPERIMENTS`. A file without it describes
        "following".
    name
        Name of the scenario; by default, the name of its file.
    description
        One line for lists and reports.
    seed
        Random seed of the run.
    published_figures
        Figures of the publication that the scenario reproduces, by their dotted paths into the
        summary; they are shown beside the run's.
    """

    experiment: str = ""
    name: str = "unnamed"
    description: str = ""
    seed: int = 0
    published_figures: dict[str, float] = field(default_factory=dict)

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        # A dataclass would represent itself by its hundreds of fields.
        cls.__repr__ = Scenario.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        name = type(self).__name__
        return f"<{name} {self.name!r}, seed {self.seed}, {self.duration:g} s; to_yaml() has all>"

    def __post_init__(self) -> None:
        check_bounds(self)
        own = type(self).experiment
        require(self.experiment == own, "experiment", self.experiment, repr(own))
        plain = self.name.strip() and not set(self.name) & set("/\\\0")
        require(bool(plain) and self.name not in (".", ".."), "name", self.name, "a plain name")
        require(self.seed >= 0, "seed", self.seed, "a whole number of at least 0")

    @property
    def duration(self) -> float:
        """Simulated time in s."""
        raise NotImplementedError

    @classmethod
    def as_published(cls, data: Mapping[str, Any]) -> dict[str, Any]:
        """Return a scenario's data with the whole published method under the data's own fields."""
        raise ConfigurationError(f"the experiment {cls.experiment!r} is of no paper")

    def to_yaml(self) -> str:
        """Return all fields as YAML that `load_scenario` reads, from whichever folder."""
        data = {each.name: getattr(self, each.name) for each in fields(self)}
        for name in data.keys() & NAMING:
            data[name] = lasting_name(data[name])
        if station := data.get("station"):
            data["station"] = replace(station, arm=lasting_name(station.arm))
        return dump_typed(data)


ScenarioT = TypeVar("ScenarioT", bound=Scenario)


def require_scenario(scenario: Scenario, wanted: type[ScenarioT]) -> ScenarioT:
    """Return a scenario after checking that it is of a certain experiment."""
    if not isinstance(scenario, wanted):
        raise ConfigurationError(
            f"{scenario.name}: a scenario of the experiment {scenario.experiment!r}; "
            f"one of {wanted.experiment!r} is needed here"
        )
    return scenario


@dataclass(frozen=True)
class Seeds:
    """Independent random seeds of the parts of a run.

    `tissue`, `insertion`: seeds of the phantom's speckle, and of needle and hand; `noise`: seed of
    the scanner's noise; `station`: seed of the wrist sensor's noise, or of the tissue's shifts;
    `tracker`: seed of the random choices of tracker or estimator.
    """

    tissue: int
    insertion: int
    noise: int
    station: int
    tracker: int


def draw_seeds(scenario: Scenario) -> Seeds:
    """Return the seeds that follow from a scenario's own."""
    return Seeds(*(int(each) for each in np.random.SeedSequence(scenario.seed).generate_state(5)))
