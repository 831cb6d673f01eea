"""Registry of the experiments: what a scenario can be a scenario of.

A new experiment is a module of this package with a subclass of `Experiment`, and a line here.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

from sonoservo.systems.files.typed_yaml import ConfigurationError, suggest

if TYPE_CHECKING:
    from sonoservo.diagrams.experiments.experiment import Experiment
    from sonoservo.diagrams.scenario import Scenario

EXPERIMENTS: Mapping[str, str] = {
    "following": "FollowingExperiment",
    "shape_prediction": "ShapePredictionExperiment",
}
"""Class of each experiment, which is in the module of the experiment's name."""


def experiment_class(name: str) -> type["Experiment[Any]"]:
    """Return the class of an experiment by its name; its module is imported only now.

    Raises
    ------
    ConfigurationError
        If there is no experiment of that name.
    """
    if not isinstance(name, str) or name not in EXPERIMENTS:
        raise ConfigurationError(f"{name!r} is not allowed; {suggest(str(name), EXPERIMENTS)}")
    module = import_module(f"{__name__}.{name}")
    found: type[Experiment[Any]] = getattr(module, EXPERIMENTS[name])
    return found


def make_experiment(scenario: "Scenario", **options: Any) -> "Experiment[Any]":
    """Make the experiment that a scenario describes.

    Parameters
    ----------
    scenario
        Scenario of any experiment.
    options
        Arguments of the experiment's class. None and False mean that an option is not asked for.

    Raises
    ------
    ConfigurationError
        If the experiment does not have an option that is asked for.
    ValueError
        If the scenario cannot be carried out; the message names the field.
    """
    kind = experiment_class(scenario.experiment)
    wanted = {
        name: value for name, value in options.items() if value is not None and value is not False
    }
    if refused := sorted(wanted.keys() - kind.options):
        possible = ", ".join(sorted(kind.options))
        raise ConfigurationError(
            f"{refused[0]}: not possible in the experiment {scenario.experiment!r}; "
            f"possible: {possible}"
        )
    return kind(scenario, **wanted)
