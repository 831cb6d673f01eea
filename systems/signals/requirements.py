"""Checks that raise a ValueError naming the field, its value and what is allowed."""

import math

import numpy as np

MAX_TIME = 1e6
"""Longest time that a scenario may ask for, in s: eleven days."""


def require(condition: bool, name: str, value: object, allowed: str) -> None:
    """Raise ValueError naming the field, its value and what is allowed, unless ``condition``."""
    if not condition:
        raise ValueError(f"{name}: {value!r} is not allowed; it must be {allowed}")


def require_positive(**values: float) -> None:
    """Raise ValueError unless every value is a finite number above zero."""
    for name, value in values.items():
        require(_is_finite(value) and value > 0, name, value, "a number above 0")


def require_not_negative(**values: float) -> None:
    """Raise ValueError unless every value is a finite number of at least zero."""
    for name, value in values.items():
        require(_is_finite(value) and value >= 0, name, value, "a number of at least 0")


def require_within(name: str, value: float, low: float, high: float) -> None:
    """Raise ValueError unless a number lies between two limits, or is equal to one."""
    require(
        _is_finite(value) and low <= value <= high, name, value, f"from {low:.4g} to {high:.4g}"
    )


def require_time(*, positive: bool = False, **values: float) -> None:
    """Raise ValueError unless every value is a time from zero, or above it, to `MAX_TIME`."""
    for name, value in values.items():
        fits = _is_finite(value) and 0 <= value <= MAX_TIME and (value > 0 or not positive)
        start = "above 0 and at most" if positive else "from 0 to"
        require(fits, name, value, f"{start} {MAX_TIME:g} s")


def _is_finite(value: object) -> bool:
    return isinstance(value, (int, float, np.number)) and math.isfinite(value)
