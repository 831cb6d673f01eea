"""Budget of memory for files and settings."""

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager

from sonoservo.systems.files.refusals import ConfigurationError

MEMORY_VARIABLE = "SONOSERVO_MAX_MEMORY"
"""Environment variable that holds the budget in GB; processes of a study inherit it."""

DEFAULT_MEMORY_GB = 4.0
"""Budget in GB unless a person sets another."""


def memory_budget() -> float:
    """Return the budget of memory for a single file or setting, in bytes."""
    text = os.environ.get(MEMORY_VARIABLE, "")
    try:
        budget = float(text or DEFAULT_MEMORY_GB)
    except ValueError:
        budget = math.nan
    if not 0 < budget < math.inf:
        raise ConfigurationError(
            f"{MEMORY_VARIABLE}: {text!r} is not allowed; it must be a number of GB above 0"
        )
    return 1e9 * budget


@contextmanager
def set_memory_budget(gigabytes: float | None, source: str) -> Iterator[None]:
    """Set the budget in GB inside the context and in its processes; ``source`` names the option."""
    if gigabytes is not None and not 0 < gigabytes < math.inf:
        raise ConfigurationError(
            f"{source}: {gigabytes} is not allowed; it must be a number of GB above 0"
        )
    before = os.environ.get(MEMORY_VARIABLE)
    if gigabytes is not None:
        os.environ[MEMORY_VARIABLE] = repr(gigabytes)
    try:
        memory_budget()
        yield
    finally:
        if before is not None:
            os.environ[MEMORY_VARIABLE] = before
        else:
            os.environ.pop(MEMORY_VARIABLE, None)


def require_memory(size: float, source: str, what: str) -> None:
    """Refuse contents (a plural) of a file or field that need more bytes than the budget."""
    budget = memory_budget()
    if not size <= budget:
        raise ConfigurationError(
            f"{source}: {what} need {1e-9 * size:.3g} GB of memory, and {1e-9 * budget:g} GB are "
            f"allowed; if that is right, raise the limit with --max-memory or {MEMORY_VARIABLE}"
        )
