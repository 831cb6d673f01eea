"""Scratch context of a plant, for a system that computes with a plant of its own."""

from typing import Any

from pydrake.common.value import Value
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import CacheEntry, Context, LeafSystem, ValueProducer


def declare_scratch_context(system: LeafSystem, plant: MultibodyPlant) -> CacheEntry:
    """Declare a scratch context of a finalized plant for each context of a system."""
    return system.DeclareCacheEntry(
        "plant_context",
        ValueProducer(
            allocate=lambda: Value[object](plant.CreateDefaultContext()),
            calc=ValueProducer.NoopCalc,
        ),
        prerequisites_of_calc={system.nothing_ticket()},
    )


def scratch_context(entry: CacheEntry, context: Context) -> Any:
    """Return the plant's scratch context that belongs to a context of the system."""
    return entry.get_mutable_cache_entry_value(context).GetMutableValueOrThrow()
