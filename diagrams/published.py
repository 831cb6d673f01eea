"""The papers, and what of their published methods a scenario can choose.

A paper's folder lies far above the scenarios, so it is named here and imported by its name.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

PAPERS: Mapping[str, tuple[str, ...]] = {
    "carriere2016": ("shape_filter",),
    "chatelain2013": ("tracker",),
    "zhao2012": ("tracker",),
}
"""Name of each paper's package, and the modules of its ``method`` that a scenario can choose.

A module "tracker" or "shape_filter" holds `PUBLISHED`: entries of the registry of that name.
"""


def method_modules(*kinds: str) -> list[str]:
    """Return the names of the papers' modules of some kinds, or of all."""
    return [
        f"sonoservo.diagrams.papers.{paper}.method.{module}"
        for paper, modules in PAPERS.items()
        for module in modules
        if not kinds or module in kinds
    ]


def published(kind: str) -> dict[Any, Any]:
    """Return the entries that the papers add to the registry "tracker" or "shape_filter"."""
    entries: dict[Any, Any] = {}
    for module in method_modules(kind):
        entries |= import_module(module).PUBLISHED
    return entries
