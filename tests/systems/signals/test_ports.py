"""Ports that know their types: found when a diagram is built, and when a value is read."""

import pytest
from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem

from sonoservo.systems.signals import (
    DiagramBuilder,
    NotFound,
    Sweep,
    Volume,
    declare_inputs,
    declare_output,
    evaluate,
)
from sonoservo.systems.signals.ports import declare_state_output, port_types


class Giver(LeafSystem):
    def __init__(self, types, from_state=False):
        super().__init__()
        self.set_name("giver")
        if from_state:
            index = self.DeclareAbstractState(Value[object](NotFound("nothing")))
            declare_state_output(self, "out", types, index)
        else:
            declare_output(self, "out", types, lambda c, out: out.set_value(NotFound("nothing")))


class Taker(LeafSystem):
    def __init__(self, types):
        super().__init__()
        self.set_name("taker")
        declare_inputs(self, volume=types)
        self.DeclareVectorOutputPort("plain", 1, lambda context, output: None)


def exported(system):
    """A diagram that holds a system and hands out its ports."""
    builder = DiagramBuilder()
    builder.AddSystem(system)
    for index in range(system.num_input_ports()):
        builder.ExportInput(system.get_input_port(index), "volume")
    builder.ExportOutput(system.get_output_port(0), "out")
    return builder.Build()


@pytest.mark.parametrize("wrap", [lambda system: system, exported], ids=["leaf", "diagram"])
@pytest.mark.parametrize("from_state", [False, True])
@pytest.mark.parametrize(
    ("given", "accepted", "fits"),
    [
        ((Volume, NotFound), (Volume, NotFound), True),
        (Volume, (Volume, NotFound), True),
        (Volume, object, True),
        ((Volume, NotFound), Volume, False),
        ((Sweep, NotFound), (Volume, NotFound), False),
    ],
)
def test_a_wrong_connection_is_found_when_a_diagram_is_built(
    wrap, from_state, given, accepted, fits
):
    builder = DiagramBuilder()
    giver = builder.AddSystem(wrap(Giver(given, from_state)))
    taker = builder.AddSystem(wrap(Taker(accepted)))
    if not fits:
        with pytest.raises(TypeError, match="'out' of .* gives .* but port 'volume' of .* accepts"):
            builder.Connect(giver.get_output_port(), taker.get_input_port())
        return
    builder.Connect(giver.get_output_port(), taker.get_input_port())
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    value = taker.get_input_port().Eval(taker.GetMyContextFromRoot(context))
    assert value == NotFound("nothing")


def test_drakes_own_types_are_left_to_drake():
    assert port_types(Taker(Volume).GetOutputPort("plain")) == ()


def test_a_value_of_another_type_is_refused_when_it_is_read():
    taker = Taker((Volume, NotFound))
    context = taker.CreateDefaultContext()
    taker.get_input_port().FixValue(context, Value[object]("text"))
    with pytest.raises(TypeError, match="'volume' of 'taker' received .* str; expected Volume or"):
        evaluate(taker, context, "volume", (Volume, NotFound))
