"""Simulated scanner to which other programs connect as they would to a real one."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from pydrake.systems.framework import System

from sonoservo.diagrams.app.options import Serving, refusing_values
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.following_scene import observer_events, recording_settings
from sonoservo.diagrams.scenario import Scenario, require_scenario
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import suggest
from sonoservo.systems.live.connection.address import parse_address
from sonoservo.systems.live.connection.link import Link
from sonoservo.systems.live.feeds import (
    NeedleNames,
    needle_feed,
    pose_feed,
    slice_feed,
    sweep_feed,
    truth_feed,
    volume_feed,
)
from sonoservo.systems.live.image_matcher import DEFAULT_POSES
from sonoservo.systems.live.sender import Sender
from sonoservo.systems.ultrasound.imaging import sweep_geometry
from sonoservo.systems.ultrasound.transducer import load_transducer

_NAMED = ("tip", "curve", "status", "covariance")

_POLL = 0.05  # Time in s between two checks of the number of peers


def live_senders(link: Link, scenario: Scenario) -> dict[str, System]:
    """Return systems that send volumes, frames, slices, pose, estimate and truth of a scenario."""
    scenario = require_scenario(scenario, FollowingScenario)
    period, offset = observer_events(scenario).values()
    frames = sweep_geometry(load_transducer(scenario.probe), scenario.imaging).frame_period
    look = {"period": period, "offset": offset}
    return {
        "sweep_sender": Sender(outlet=link, feed=sweep_feed(posed=False), **look),
        "volume_sender": Sender(
            outlet=link,
            feed=volume_feed(settings=recording_settings(scenario), posed=False),
            **look,
        ),
        "slice_sender": Sender(outlet=link, feed=slice_feed(), **look),
        "needle_sender": Sender(outlet=link, feed=needle_feed(), **look),
        "pose_sender": Sender(outlet=link, feed=pose_feed(DEFAULT_POSES), period=frames),
        "truth_sender": Sender(outlet=link, feed=truth_feed(), period=frames),
    }


@contextmanager
def opened(address: str, say: Callable[[str], None]) -> Iterator[Link]:
    """Open a connection and say where; on exit, queued messages get 1 s to be sent."""
    with Link(parse_address(address), report=say) as link:
        if link.address.listens:
            host, _ = link.address.bound
            say(f"Sending to all peers that connect to igtl://{host}:{link.port}")
        yield link
        link.flush(1.0)


def await_peers(link: Link, count: int) -> None:
    """Wait until so many peers have connected."""
    while link.peers < count:
        time.sleep(_POLL)


@contextmanager
def serving(
    serve: Serving, scenario: Scenario, say: Callable[[str], None]
) -> Iterator[tuple[Mapping[str, System] | None, Callable[[], None]]]:
    """Yield the systems that send a scenario live, and what waits for their peers before it runs.

    Without an address there are no systems, and nothing is waited for.
    """
    if serve.serve is None:
        yield None, lambda: None
        return
    with opened(serve.serve, say) as link:
        yield live_senders(link, scenario), lambda: await_peers(link, serve.wait_for)


def needle_names(changes: Sequence[str], *, points: bool = False) -> NeedleNames:
    """Return the device names of estimates, changed by texts such as ``tip=MyNeedle``."""
    names = NeedleNames(points=points)
    for change in changes:
        field, equals, name = change.partition("=")
        if field not in _NAMED or not equals:
            raise ConfigurationError(f"name: {change!r}; {suggest(field, _NAMED)}")
        changed: dict[str, Any] = {field: name}
        with refusing_values():
            names = replace(names, **changed)
    return names
