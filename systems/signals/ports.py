"""Ports that know the types of their values.

Drake knows the size of a vector and its own types. It sees ``Value[object]`` on every wire that
carries a Python object, and connects any two of them. A port of such objects declared here states
its types in its model value, which diagrams hand on with the ports they export; `DiagramBuilder`
compares them when it connects.
"""

from collections.abc import Callable, Iterable
from typing import Any, TypeVar, overload

from pydrake.common.value import AbstractValue, Value
from pydrake.systems import framework
from pydrake.systems.framework import (
    AbstractStateIndex,
    Context,
    InputPort,
    LeafSystem,
    OutputPort,
    PortDataType,
    System,
)

T = TypeVar("T")
U = TypeVar("U")
Types = type | tuple[type, ...]


def _model(types: Types) -> AbstractValue:
    """Return the model value of an abstract port: of Drake's own type, or the types of objects."""
    if isinstance(types, type) and types.__module__.startswith("pydrake."):
        return Value(types())
    return Value[object](types)


def declare_inputs(system: LeafSystem, **types: Types | int) -> dict[str, InputPort]:
    """Declare input ports by name: the type or types that each accepts, or the size of a vector."""
    return {
        name: system.DeclareVectorInputPort(name, accepted)
        if isinstance(accepted, int)
        else system.DeclareAbstractInputPort(name, _model(accepted))
        for name, accepted in types.items()
    }


def declare_output(
    system: LeafSystem,
    name: str,
    types: Types | int,
    calc: Callable[[Context, Any], None],
    prerequisites: Iterable[Any] | None = None,
) -> OutputPort:
    """Declare an output port that gives values of a type or types, or a vector of a size.

    The callback sets the port's value. Prerequisites are the tickets of all that it depends on;
    every source if None.
    """
    tickets = {} if prerequisites is None else {"prerequisites_of_calc": set(prerequisites)}
    if isinstance(types, int):
        return system.DeclareVectorOutputPort(name, types, calc, **tickets)
    return system.DeclareAbstractOutputPort(name, _model(types).Clone, calc, **tickets)


def declare_state_output(
    system: LeafSystem, name: str, types: Types, index: AbstractStateIndex
) -> OutputPort:
    """Declare an output port that gives an abstract state of the system, with its types."""

    def calc(context: Context, output: Any) -> None:
        output.set_value(context.get_abstract_state(index).get_value())

    return declare_output(system, name, types, calc, {system.abstract_state_ticket(index)})


def port_types(port: InputPort | OutputPort) -> tuple[type, ...]:
    """Return the types that a port declares; empty for Drake's own types."""
    if port.get_data_type() != PortDataType.kAbstractValued:
        return ()
    incoming = isinstance(port, InputPort)
    model = port.get_system().AllocateInputAbstract(port) if incoming else port.Allocate()
    types = model.get_value() if isinstance(model, Value[object]) else ()
    types = types if isinstance(types, tuple) else (types,)
    return types if all(isinstance(each, type) for each in types) else ()


class DiagramBuilder(framework.DiagramBuilder):
    """Builder of diagrams that refuses to connect ports of different types."""

    def Connect(self, output: OutputPort, input: InputPort) -> None:
        """Connect two ports; a TypeError names both if the input refuses what the output gives."""
        given, accepted = port_types(output), port_types(input)
        if given and accepted and not all(issubclass(each, accepted) for each in given):
            raise TypeError(
                f"{_name(output)} gives {_words(given)}, but {_name(input)} accepts "
                f"{_words(accepted)}"
            )
        super().Connect(output, input)


@overload
def evaluate(system: System, context: Context, port: str, expected: type[T]) -> T: ...
@overload
def evaluate(
    system: System, context: Context, port: str, expected: tuple[type[T], type[U]]
) -> T | U: ...
@overload
def evaluate(system: System, context: Context, port: str, expected: tuple[type[T], ...]) -> T: ...
def evaluate(system: System, context: Context, port: str, expected: Types) -> Any:
    """Evaluate an abstract input port; a TypeError names it if the value has another type."""
    return evaluate_port(system.GetInputPort(port), context, expected)


def evaluate_optional(
    system: System, context: Context, port: str, expected: type[T] | tuple[type[T], ...]
) -> T | None:
    """Evaluate an abstract or vector input port as `evaluate` does; None if it has no value."""
    return evaluate_optional_port(system.GetInputPort(port), context, expected)


def evaluate_optional_port(
    port: InputPort, context: Context, expected: type[T] | tuple[type[T], ...]
) -> T | None:
    """Evaluate a port as `evaluate_optional` does, without looking it up by its name."""
    return evaluate_port(port, context, expected) if port.HasValue(context) else None


def evaluate_port(port: InputPort, context: Context, expected: type[T] | tuple[type[T], ...]) -> T:
    """Evaluate an abstract input port as `evaluate` does, without looking it up by its name."""
    value = port.Eval(context)
    if not isinstance(value, expected):
        types = expected if isinstance(expected, tuple) else (expected,)
        raise TypeError(
            f"{_name(port)} received a value of type {type(value).__name__}; "
            f"expected {_words(types)}"
        )
    return value


def _name(port: InputPort | OutputPort) -> str:
    return f"port {port.get_name()!r} of {port.get_system().get_name()!r}"


def _words(types: tuple[type, ...]) -> str:
    return " or ".join(each.__name__ for each in types)
