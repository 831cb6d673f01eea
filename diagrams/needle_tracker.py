"""Needle trackers: diagrams that turn volumes into an estimate of the needle."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import cast

from pydrake.common.value import Value
from pydrake.systems.framework import Context, Diagram, System

from sonoservo.diagrams.trackers.chatelain2013 import Chatelain2013TrackerParameters
from sonoservo.diagrams.trackers.registry import TRACKERS
from sonoservo.diagrams.trackers.tracker_parts import TrackerParameters
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.volume import Volume


def MakeNeedleTracker(
    *,
    parameters: TrackerParameters | None = None,
    period: float,
    offset: float = 0.0,
    seed: int = 0,
) -> Diagram:
    """Make a needle tracker.

    .. pydrake_system::

        name: needle_tracker
        input_ports:
        - volume
        output_ports:
        - estimate
        - measurement
        - detection
        - explanation
        - volume_check

    ``volume`` is a `Volume`, or a `NotFound` while there is none; ``estimate`` a `NeedleEstimate`.
    ``measurement`` and ``detection`` are those of the last update, for a log. ``explanation`` is
    the `LocalizationExplanation` of the volume at the input, computed on demand.
    ``volume_check`` is the `VolumeCheck` of all volumes so far; refused volumes are not tracked.

    Parameters
    ----------
    parameters
        Parameters of one of the `TRACKERS`; their class chooses the tracker.
    period, offset
        Period and offset of the events at which it looks for a new volume, in s.
    seed
        Seed of every random choice.
    """
    parameters = parameters or Chatelain2013TrackerParameters()
    diagram = TRACKERS[type(parameters)](
        parameters=parameters,
        period=period,
        offset=offset,
        seed=seed,
    )
    diagram.set_name("needle_tracker")
    return diagram


def require_tracker(tracker: object) -> System | None:
    """Return a custom tracker, or None, after checking that it is a system with a tracker's ports.

    Raises
    ------
    ConfigurationError
        If it is something else, or lacks a port.
    """
    if tracker is None:
        return None
    if not isinstance(tracker, System):
        kind = tracker.__name__ if isinstance(tracker, type) else type(tracker).__name__
        what = f"the class {kind}" if isinstance(tracker, type) else f"a value of type {kind}"
        raise ConfigurationError(f"tracker: {what}; expected an instance of a Drake system")
    name = type(tracker).__name__
    for wanted, side, exists in (
        ("volume", "input", tracker.HasInputPort("volume")),
        ("estimate", "output", tracker.HasOutputPort("estimate")),
    ):
        if not exists:
            raise ConfigurationError(
                f"tracker: {name} has no {side} port {wanted!r}; a tracker has the input 'volume' "
                "and the output 'estimate'"
            )
    return tracker


def track(
    volumes: Iterable[Volume],
    *,
    parameters: TrackerParameters | None = None,
    seed: int = 0,
) -> Iterator[NeedleEstimate]:
    """Track a needle through volumes in order of time, without a simulation.

    Each estimate is available as soon as its volume is, so the volumes may come from a live
    scanner.

    Parameters
    ----------
    volumes
        Volumes from any source.
    parameters
        Parameters of the tracker.
    seed
        Seed of every random choice.

    Returns
    -------
    An iterator over the estimates, one after each volume.

    Raises
    ------
    ConfigurationError
        If an argument is of another type.
    """
    if isinstance(volumes, str | Path):
        raise ConfigurationError(
            f"volumes: {str(volumes)!r} is one path; expected Volume objects. "
            "track_recording(Recording(path)) tracks the volumes of a file"
        )
    if not isinstance(parameters, TrackerParameters | None):
        raise ConfigurationError(
            f"parameters: a value of type {type(parameters).__name__}; expected those of a "
            'tracker, such as tracker_parameters(start="anywhere")'
        )
    return _track(volumes, parameters, seed)


def _track(
    volumes: Iterable[Volume], parameters: TrackerParameters | None, seed: int
) -> Iterator[NeedleEstimate]:
    tracker = MakeNeedleTracker(parameters=parameters, period=1.0, seed=seed)
    context = tracker.CreateDefaultContext()
    for volume in volumes:
        yield track_volume(tracker, context, volume)


def track_volume(tracker: System, context: Context, volume: Volume) -> NeedleEstimate:
    """Give a tracker its next volume, outside a simulation, and return the estimate.

    Parameters
    ----------
    tracker
        System with the input volume and the output estimate.
    context
        Context of the tracker, which this changes.
    volume
        Next volume.
    """
    # Time does not advance, so an event is forced.
    tracker.GetInputPort("volume").FixValue(context, Value[object](volume))
    tracker.ExecuteForcedEvents(context)
    return cast(NeedleEstimate, tracker.GetOutputPort("estimate").Eval(context))
