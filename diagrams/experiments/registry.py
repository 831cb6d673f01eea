"""Registry of the experiments (each a module, its presenter, and a line here) and scenarios."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from sonoservo.systems.files.model_file import NAMING
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.typed_yaml import (
    apply_changes,
    load_typed,
    merged,
    read_yaml,
    suggest,
)
from sonoservo.systems.files.writing import to_plain

if TYPE_CHECKING:
    from sonoservo.diagrams.experiments.experiment import Experiment
    from sonoservo.diagrams.experiments.presenter import Presenter
    from sonoservo.diagrams.scenario import Scenario

EXPERIMENTS: Mapping[str, str] = {"following": "Following", "shape_prediction": "ShapePrediction"}
"""Beginning of the names of each experiment's classes, by the name of its module."""


def experiment_class(name: str) -> type["Experiment[Any]"]:
    """Return the class of an experiment by its name; its module is imported on demand."""
    if not isinstance(name, str) or name not in EXPERIMENTS:
        raise ConfigurationError(f"{name!r} is not allowed; {suggest(str(name), EXPERIMENTS)}")
    module = import_module(f"sonoservo.diagrams.experiments.{name}")
    found: type[Experiment[Any]] = getattr(module, f"{EXPERIMENTS[name]}Experiment")
    return found


def presenter_class(name: str) -> "type[Presenter]":
    """Return the class that presents the runs of an experiment, by the experiment's name."""
    module = import_module(f"sonoservo.diagrams.experiments.{name}_presenter")
    found: type[Presenter] = getattr(module, f"{EXPERIMENTS[name]}Presenter")
    return found


def present(experiment: "Experiment[Any]") -> "Presenter":
    """Return the presenter of an experiment's run, for words, plots and pictures."""
    return presenter_class(experiment.scenario.experiment)(experiment)


def make_experiment(scenario: "Scenario", **options: Any) -> "Experiment[Any]":
    """Make a scenario's experiment; options are its class's arguments, None or False if unset."""
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


def list_scenarios() -> dict[str, Path]:
    """Return the paths of the built-in scenarios, by name."""
    folder = Path(str(files("sonoservo.diagrams"))) / "scenarios"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def describe_scenarios() -> dict[str, str]:
    """Return the descriptions of the built-in scenarios, by name."""
    return {name: read_yaml(path)["description"] for name, path in list_scenarios().items()}


def load_scenario(
    scenario: "Scenario | str | Path | Mapping[str, Any]",
    *,
    changes: Mapping[str, Any] | Sequence[str] | None = None,
    seed: int | None = None,
    as_published: bool = False,
) -> "Scenario":
    """Load a scenario of any experiment.

    Parameters
    ----------
    scenario
        Name of a built-in scenario, path of a YAML file, its data, or a scenario to change. Files
        that a YAML file names are looked for beside it first.
    changes
        Fields to change: values by dotted path, ``{"imaging.gain": 0.5}``, or assignments
        ``"path.to.field=value"`` with the value in YAML.
    seed
        Seed that replaces the scenario's own.
    as_published
        Whether to replace our methods by the whole published one, below the fields of the file and
        the changes.

    Returns
    -------
    The scenario, of the class that belongs to its experiment.

    Raises
    ------
    ConfigurationError
        If there is no such scenario, or a field is wrong; the message then names the field, its
        value and what is allowed.
    """
    from sonoservo.diagrams.scenario import Scenario

    if isinstance(scenario, Scenario):
        if changes is None and seed is None:
            return scenario
        scenario = yaml.safe_load(scenario.to_yaml())
    if isinstance(scenario, Mapping):
        whole, source = dict(scenario), str(scenario.get("name"))
        before = _needle_of(whole)
        _change(whole, changes, seed)
        if _needle_of(whole) != before:
            whole = _with_other_needle(whole, changes, seed)
        return load_typed(_schema(whole, source), whole, source)
    if not isinstance(scenario, str | Path):
        raise ConfigurationError(
            f"scenario: a value of type {type(scenario).__name__}; expected the name of a built-in "
            "scenario, or the path of a YAML file"
        )
    known = list_scenarios()
    path = known.get(str(scenario), Path(scenario))
    if path.suffix not in (".yaml", ".yml"):
        raise ConfigurationError(f"unknown scenario {str(scenario)!r}; {suggest(path.name, known)}")
    data: dict[str, Any] = {"name": path.stem, **read_yaml(path)}
    _look_beside(data, path.parent)
    kind = data.get("needle")
    _change(data, changes, seed)
    if data.get("needle") == kind:
        data = merged(_of_needle(data), data)
    else:
        data = _with_other_needle(data, changes, seed)
    if as_published:
        published = _schema(data, scenario).as_published(data)
        data = {**published, "name": f"{data['name']}_as_published"}
    return load_typed(_schema(data, scenario), data, str(scenario))


def _look_beside(data: dict[str, Any], folder: Path) -> None:
    """Let the files that a scenario's data name count from its own folder, if they lie there."""
    station = data.get("station")
    for part in [data, station] if isinstance(station, dict) else [data]:
        for name in part.keys() & NAMING:
            file = part[name]
            if isinstance(file, str) and Path(file).suffix and (folder / file).is_file():
                part[name] = str(folder / file)


def _with_other_needle(
    data: dict[str, Any], changes: Mapping[str, Any] | Sequence[str] | None, seed: int | None
) -> dict[str, Any]:
    """Return changed data in which the needle replaces what was set, except for other changes."""
    data = merged(data, _of_needle(data))
    _change(data, changes, seed)
    return data


def _change(
    data: dict[str, Any], changes: Mapping[str, Any] | Sequence[str] | None, seed: int | None
) -> None:
    """Apply changes to a scenario's data, and its seed."""
    changed: dict[str, Any] = {}
    apply_changes(changed, changes)
    _suit_probe(data, data)
    apply_changes(data, changes)
    _suit_probe(data, changed)
    if seed is not None:
        data["seed"] = to_plain(seed, for_json=False)


def _suit_probe(data: dict[str, Any], given: Mapping[str, Any]) -> None:
    """Set the middle of a given probe's frequencies, unless one is given or what is set fits."""
    probe, imaging = given.get("probe"), data.get("imaging", {})
    told = given.get("imaging", {})
    if not (isinstance(probe, str) and isinstance(imaging, dict) and isinstance(told, dict)):
        return  # no other probe, or an error that the schema explains
    if "transmit_frequency" in told:
        return
    # Loaded here, so that a list of scenarios needs no renderer.
    from sonoservo.systems.ultrasound.transducer import load_transducer

    name = str(data.get("name"))
    with refusing_failures(name):
        transducer = load_transducer(probe)
    low, high = transducer.lowest_frequency, transducer.highest_frequency
    usual = _schema(data, name)().imaging.transmit_frequency  # type: ignore[attr-defined]
    with suppress(TypeError, ValueError):  # no number, as the schema explains
        if not low <= float(imaging.get("transmit_frequency", usual)) <= high:
            data["imaging"] = {**imaging, "transmit_frequency": (low + high) / 2}


def _needle_of(data: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return a scenario's kind of needle, with the seed if that draws it."""
    kind = data.get("needle")
    return kind, data.get("seed", 0) if kind == "drawn" else None


def _of_needle(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a scenario that its kind of needle sets."""
    if not isinstance(data.get("needle"), str):
        return {}
    # Loaded here, so that a list of scenarios needs no renderer.
    from sonoservo.systems.ultrasound.simulation.needles.needle_kind import (
        DRAWN,
        draw_needle,
        load_needle,
    )

    if data["needle"] == DRAWN:
        return draw_needle(to_plain(data.get("seed", 0), for_json=False))
    kind = load_needle(data["needle"])
    return {"hand": {"gauge": kind.gauge}, "scanner": {"needle": asdict(kind.echo)}}


def _schema(data: Mapping[str, Any], scenario: str | Path) -> "type[Scenario]":
    """Return the class of the scenarios of the experiment that a scenario's data name."""
    try:
        return experiment_class(data.get("experiment", "following")).scenario_class
    except ConfigurationError as error:
        raise ConfigurationError(f"{scenario}: experiment: {error}") from error
