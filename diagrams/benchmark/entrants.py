"""Trackers that enter the benchmark: one of ours, a factory in a module, or a folder of tables."""

import hashlib
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from inspect import getsourcefile
from pathlib import Path
from typing import Any

from pydrake.systems.framework import System

from sonoservo.diagrams.benchmark.estimates import estimates_text, read_estimates
from sonoservo.diagrams.needle_tracker import MakeNeedleTracker, require_tracker
from sonoservo.diagrams.tracker_bench import TrackerBench
from sonoservo.diagrams.trackers.registry import TRACKERS
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import suggest
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.volume import Volume

BRIGHTEST_LINE = "sonoservo.diagrams.benchmark.brightest_line:make"
"""Factory of the example in the documentation, by the name ``brightest_line``."""

Step = Callable[[Volume], NeedleEstimate]


def sequence_name(suite: str, seed: int) -> str:
    """Return the name of a sequence's files: ``clean_seed000``."""
    return f"{suite.replace(' ', '_').replace('-', '_')}_seed{seed:03d}"


def resolve_entrant(text: str, sequences: Mapping[str, Any]) -> dict[str, Any]:
    """Return a tracker's settings for a case: kind, module:factory with its digest, or tables."""
    kinds = {each.kind for each in TRACKERS}
    if text in kinds:
        return {"name": text, "kind": text}
    if text == "brightest_line":
        return {**resolve_entrant(BRIGHTEST_LINE, sequences), "name": text}
    if Path(text).is_dir():
        folder = Path(text)
        tables = {name: read_estimates(folder, name) for name in sequences}
        if not any(tables.values()):
            example = next(iter(sequences), "")
            raise ConfigurationError(
                f"{text}: it has no table of a sequence, such as {example}.csv"
            )
        return {
            "name": folder.resolve().name,
            "tables": {name: estimates_text(rows) for name, rows in tables.items()},
        }
    if ":" in text:
        factory = load_factory(text)
        try:
            source = getsourcefile(factory)
        except TypeError:  # an object that is called, such as a partial
            source = getsourcefile(type(factory))
        code = hashlib.sha256(Path(source).read_bytes()).hexdigest() if source else ""
        return {"name": text.removesuffix(":make"), "factory": text, "code": code}
    known = [*sorted(kinds), "brightest_line"]
    raise ConfigurationError(
        f"unknown tracker {text!r}: neither a folder of tables nor module:factory; "
        f"{suggest(text, known)}"
    )


def load_factory(text: str) -> Callable[[], Any]:
    """Return the factory that ``module:factory`` names; modules of this folder count, too."""
    module, _, name = text.partition(":")
    if "" not in sys.path:
        sys.path.insert(0, "")
    try:
        found = getattr(import_module(module.removesuffix(".py")), name)
    except (Exception, SystemExit) as error:  # whatever a module does when it is imported
        if isinstance(error, ModuleNotFoundError) and error.name == module.removesuffix(".py"):
            raise ConfigurationError(
                f"{text}: there is no module {error.name!r}, neither installed nor in {Path.cwd()}"
            ) from error
        raise ConfigurationError(f"{text}: {type(error).__name__}: {error}") from error
    if not callable(found):
        raise ConfigurationError(f"{text}: {name} is not a function that makes a tracker")
    factory: Callable[[], Any] = found
    return factory


def start_tracker(entrant: Mapping[str, Any], seed: int) -> Step:
    """Return a function from the next volume to the estimate after it, made once a sequence."""
    if "kind" in entrant:
        kind = next(each for each in TRACKERS if each.kind == entrant["kind"])
        made: Any = MakeNeedleTracker(parameters=kind(), period=1.0, seed=seed)
    else:
        made = load_factory(entrant["factory"])()
    if isinstance(made, System):
        tracker = require_tracker(made)
        assert tracker is not None
        return TrackerBench(tracker, logged=False).track
    if not callable(made):
        raise ConfigurationError(
            f"{entrant['name']}: it made a value of type {type(made).__name__}; expected a "
            "function of a Volume, or a Drake system"
        )
    step: Step = made
    return step


def checked(step: Step, volume: Volume, name: str) -> NeedleEstimate:
    """Return a tracker's estimate after a volume, after a check of its type."""
    estimate = step(volume)
    if not isinstance(estimate, NeedleEstimate):
        raise ConfigurationError(
            f"{name}: it returned a value of type {type(estimate).__name__}; expected a "
            "NeedleEstimate"
        )
    return estimate
