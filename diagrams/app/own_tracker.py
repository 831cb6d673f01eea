"""Trackers of a user's own, as the benchmark takes them, in the place of the built-in ones."""

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from numbers import Real
from pathlib import Path
from traceback import extract_tb
from typing import TypeAlias

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State, System

from sonoservo.diagrams.benchmark.entrants import Step, checked, resolve_entrant, start_tracker
from sonoservo.systems.files.refusals import ConfigurationError, describe, refusing_failures
from sonoservo.systems.files.volume_file import MAX_STEP
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.requirements import within
from sonoservo.systems.signals.volume import Volume

_OURS = tuple(str(Path(__file__).parents[2] / part) for part in ("systems", "diagrams"))
"""Folders whose lines tell an author nothing about a failure of their tracker."""

_FARTHEST = 1.0  # distance of a tip from the probe in m: no image is as deep

OwnTracker: TypeAlias = System | Callable[[Volume], NeedleEstimate] | str
"""A system, a function from the next volume to the estimate after it, or ``module:factory`` of
either."""


def is_factory(text: str) -> bool:
    """Return True for ``module:factory``; other texts name a built-in tracker."""
    return ":" in text and not text.lstrip().startswith("{")


def without_own_tracker(changes: Sequence[str] | None) -> tuple[list[str], str | None]:
    """Return a scenario's changes without ``tracker=module:factory``, and that factory if any.

    A tracker of one's own is no field of a scenario.
    """
    own, fields = None, []
    for each in changes or []:
        name, _, value = each.partition("=")
        if name == "tracker" and is_factory(value):
            own = value
        else:
            fields.append(each)
    return fields, own


def _importable(text: str) -> str:
    """Return ``module:factory`` for ``folder/module.py:factory``, whose folder is searched then."""
    module, _, name = text.partition(":")
    path = Path(module)
    if path.suffix != ".py" and len(path.parts) == 1:
        return text
    sys.path.insert(0, str(path.parent))
    return f"{path.name.removesuffix('.py')}:{name}"


def as_system(tracker: OwnTracker, *, period: float, offset: float = 0.0) -> System:
    """Return a tracker as a system that looks for a volume at such times, in s.

    A system has its own times and is returned as it is, and so is what is no tracker.
    """
    if isinstance(tracker, str):
        with refusing_failures(
            tracker,
            "it is called without arguments, to return a function of a Volume or a Drake system",
        ):
            step = start_tracker(resolve_entrant(_importable(tracker), {}), seed=0)
        name = tracker
        module, _, function = tracker.partition(":")
    elif isinstance(tracker, System | type) or not callable(tracker):
        return tracker
    else:
        step, function = tracker, getattr(tracker, "__qualname__", type(tracker).__qualname__)
        module = tracker.__module__
        name = f"{module}.{function}"
    # A run names the class of the tracker that it had.
    kind = type(function, (_FunctionTracker,), {"__module__": module})
    made: System = kind(step, name, period, offset)
    return made


class _FunctionTracker(LeafSystem):
    """Gives each new volume at its input to a function, once, and outputs the estimate.

    .. pydrake_system::

        name: FunctionTracker
        input_ports:
        - volume
        output_ports:
        - estimate
    """

    def __init__(self, step: Step, name: str, period: float, offset: float) -> None:
        super().__init__()
        self._step, self._name = step, name
        self.DeclareAbstractInputPort("volume", Value[object]())
        searching = NeedleEstimate(TrackingMode.SEARCHING, time=0.0)
        self._newest = self.DeclareAbstractState(Value[object](None))
        self._estimate = self.DeclareAbstractState(Value[object](searching))
        self.DeclareStateOutputPort("estimate", self._estimate)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self._update)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update)

    def _update(self, context: Context, state: State) -> EventStatus:
        volume = self.GetInputPort("volume").Eval(context)
        newest = context.get_abstract_state(self._newest).get_value()
        if not isinstance(volume, Volume) or volume is newest:
            return EventStatus.DidNothing()
        try:
            estimate = checked(self._step, volume, self._name)
        except (ConfigurationError, KeyboardInterrupt):
            raise
        except BaseException as error:  # it may call sys.exit
            calls = extract_tb(error.__traceback__)
            theirs = [each for each in calls if not each.filename.startswith((*_OURS, "<"))]
            where = f", in {theirs[-1].filename}, line {theirs[-1].lineno}" if theirs else ""
            raise ConfigurationError(
                f"{self._name}: this tracker of yours failed at {volume.time:.2f} s{where}: "
                f"{type(error).__name__}: {describe(error)}"
            ) from error
        if fault := _fault(estimate, volume):
            raise ConfigurationError(f"{self._name}: {fault}")
        if estimate.volume_time != volume.time:
            estimate = replace(estimate, volume_time=volume.time)
        state.get_mutable_abstract_state(self._newest).set_value(volume)
        state.get_mutable_abstract_state(self._estimate).set_value(estimate)
        return EventStatus.Succeeded()


def _fault(estimate: NeedleEstimate, volume: Volume) -> str:
    """Return what is wrong with an estimate after a volume; empty if nothing is."""
    if estimate.mode not in list(TrackingMode):
        return f"mode: {estimate.mode!r}; one of {', '.join(TrackingMode)}"
    if estimate.mode == TrackingMode.SEARCHING and estimate:
        return "mode: searching, with a curve; one that is found is tracking"
    if estimate.mode in (TrackingMode.TRACKING, TrackingMode.COASTING) and not estimate:
        return f"mode: {estimate.mode}, without a curve"
    if estimate and (estimate.velocity is None or estimate.covariance is None):
        return "an estimate with a curve needs its velocity and covariance as well"
    if not within(0, 1).fits(estimate.probability):
        return f"probability: {estimate.probability} is not allowed; it must be from 0 to 1"
    if not (isinstance(estimate.time, Real) and math.isfinite(estimate.time)):
        return f"time: {estimate.time} is not allowed; it must be a number of seconds"
    if estimate.time > volume.time + MAX_STEP:
        return f"its estimate is {estimate.time - volume.time:.3g} s ahead of its volume"
    if estimate.covariance is not None:
        variances = np.linalg.eigvalsh(estimate.covariance)
        if variances[0] < -1e-6 * abs(variances[-1]):
            return "its covariance has negative variances"
    if estimate.curve is not None:
        away = float(np.linalg.norm(estimate.curve.tip - volume.X_WP.translation()))
        if away > _FARTHEST:
            return (
                f"its tip lies {away:.3g} m from the probe; a curve's control points are in W, in m"
            )
    return ""
