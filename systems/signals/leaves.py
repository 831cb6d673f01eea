"""Declarations that many leaves share: memory of their own, and regular looks at their inputs."""

from collections.abc import Callable
from typing import Any, TypeVar

from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem, ValueProducer

from sonoservo.systems.signals.requirements import require_not_negative, require_positive

T = TypeVar("T")


def declare_memory(system: LeafSystem, make: Callable[[], T]) -> Callable[[Context], T]:
    """Declare a mutable object for each context of a system; return a function that finds it."""
    entry = system.DeclareCacheEntry(
        "memory",
        ValueProducer(lambda: Value[object](make()), ValueProducer.NoopCalc),
        {system.nothing_ticket()},
    )
    return entry.Eval


def declare_looks(
    system: LeafSystem,
    look: Callable[[Context], Any],
    *,
    period: float,
    offset: float = 0.0,
    start: Callable[[Context], Any] | None = None,
) -> None:
    """Declare publish events: regular ones, a forced one, and one at the start of each run."""
    require_positive(period=period)
    require_not_negative(offset=offset)
    if start is not None:
        system.DeclareInitializationPublishEvent(start)
    system.DeclarePeriodicPublishEvent(period, offset, look)
    system.DeclareForcedPublishEvent(look)
