"""Typed access to a system's abstract input ports."""

from typing import Any, TypeVar, overload

from pydrake.systems.framework import Context, InputPort, System

T = TypeVar("T")
U = TypeVar("U")


@overload
def evaluate(system: System, context: Context, port: str, expected: type[T]) -> T: ...
@overload
def evaluate(
    system: System, context: Context, port: str, expected: tuple[type[T], type[U]]
) -> T | U: ...
@overload
def evaluate(system: System, context: Context, port: str, expected: tuple[type[T], ...]) -> T: ...
def evaluate(system: System, context: Context, port: str, expected: type | tuple[type, ...]) -> Any:
    """Evaluate an abstract input port and check the type of its value.

    ``Value[object]`` ports are untyped, and ``Connect`` silently accepts a wrong connection. This
    function detects it.

    Raises
    ------
    TypeError
        If the value is of another type.
    """
    return evaluate_port(system.GetInputPort(port), context, expected)


def evaluate_port(port: InputPort, context: Context, expected: type[T] | tuple[type[T], ...]) -> T:
    """Evaluate an abstract input port as `evaluate` does, without looking it up by its name."""
    value = port.Eval(context)
    if not isinstance(value, expected):
        names = expected if isinstance(expected, tuple) else (expected,)
        wanted = " or ".join(each.__name__ for each in names)
        raise TypeError(
            f"port {port.get_name()!r} of {port.get_system().get_name()!r} received a value of "
            f"type {type(value).__name__}; expected {wanted}"
        )
    return value
