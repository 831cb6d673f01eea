"""Messages from a Meshcat page: what is allowed, and how it is passed on."""

import math
from typing import Any

import umsgpack

_MAX_NAME = 200
_MAX_AXES = 64


def checked_message(data: bytes) -> bytes:
    """Return a message of a Meshcat page, packed anew from its known fields only.

    Drake's server ends itself, and the run with it, on messages that are not whole. Poses of the
    page's camera are refused, because it does the same if one is no rotation, and nobody reads
    them.

    Parameters
    ----------
    data
        Message as the page sent it: a MessagePack map of a button, a slider or a gamepad.

    Raises
    ------
    ValueError
        If it is none of these, or a field is missing or has another type.
    """
    try:
        message = umsgpack.unpackb(data)
    except (umsgpack.UnpackException, ArithmeticError, RecursionError, TypeError, ValueError):
        raise ValueError("it is not MessagePack") from None
    kind = message.get("type") if isinstance(message, dict) else None
    if kind == "button":
        fields: dict[str, Any] = {"name": _name(message)}
    elif kind == "slider":
        fields = {"name": _name(message), "value": _number(message.get("value"))}
    elif kind == "gamepad":
        fields = {"name": "", "gamepad": _gamepad(message.get("gamepad"))}
    else:
        raise ValueError("it is of no known type")
    packed: bytes = umsgpack.packb({"type": kind, **fields})
    return packed


def _name(message: dict[Any, Any]) -> str:
    name = message.get("name")
    if not isinstance(name, str) or len(name) > _MAX_NAME:
        raise ValueError("it has no name")
    return name


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("a number is missing")
    number = float(value)
    if not math.isfinite(number):
        raise ValueError("a number is not finite")
    return number


def _numbers(values: Any) -> list[float]:
    if not isinstance(values, list) or len(values) > _MAX_AXES:
        raise ValueError("a list of numbers is missing or too long")
    return [_number(value) for value in values]


def _gamepad(value: Any) -> dict[str, Any]:
    """Return a gamepad's state; empty if it is no longer connected."""
    if not isinstance(value, dict):
        raise ValueError("it has no gamepad")
    if not value:
        return {}
    index = value.get("index")
    if not isinstance(index, int) or not 0 <= index < 64:
        raise ValueError("the gamepad has no index")
    axes, buttons = _numbers(value.get("axes")), _numbers(value.get("button_values"))
    return {"index": int(index), "button_values": buttons, "axes": axes}
