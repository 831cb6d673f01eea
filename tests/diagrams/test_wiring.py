import pytest
from pydrake.common.value import Value
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from sonoservo.diagrams import connect_by_name
from sonoservo.diagrams.wiring import TRUTH


class Ports(LeafSystem):
    """A system with nothing but ports; its outputs hold its name."""

    def __init__(self, *, inputs=(), outputs=()):
        super().__init__()
        for name in inputs:
            self.DeclareAbstractInputPort(name, Value[object]())
        for name in outputs:
            self.DeclareAbstractOutputPort(
                name,
                lambda: Value[object](),
                lambda context, output: output.set_value(self.get_name()),
            )


def connect(systems, **options):
    builder = DiagramBuilder()
    for name, system in systems.items():
        builder.AddNamedSystem(name, system)
    connect_by_name(builder, systems, **options)
    return builder.Build()


def test_ports_of_one_name_are_connected():
    tracker = Ports(inputs=["volume"], outputs=["estimate"])
    systems = {
        "converter": Ports(outputs=["volume"]),
        "tracker": tracker,
        "logger": Ports(inputs=["volume", "estimate", "detection"]),
    }
    diagram = connect(systems, optional=["detection"])
    context = diagram.CreateDefaultContext()
    seen = {
        name: systems["logger"].GetInputPort(name) for name in ("volume", "estimate", "detection")
    }
    logger_context = systems["logger"].GetMyContextFromRoot(context)
    assert seen["volume"].Eval(logger_context) == "converter"
    assert seen["estimate"].Eval(logger_context) == "tracker"
    assert not seen["detection"].HasValue(logger_context)


def test_two_outputs_of_one_name_are_an_error_that_names_both_systems():
    systems = {"hand": Ports(outputs=["needle"]), "tracker": Ports(outputs=["needle"])}
    with pytest.raises(ValueError, match="hand and tracker both have an output 'needle'"):
        connect(systems)


def test_an_input_without_an_output_is_an_error_that_names_what_there_is():
    systems = {
        "hand": Ports(outputs=["needle"]),
        "scanner": Ports(outputs=["sweep", "volume"]),
        "tracker": Ports(inputs=["speckle"]),
    }
    message = "tracker has an input 'speckle', but there is no such output; there are sweep, volume"
    with pytest.raises(ValueError, match=f"{message}$"):
        connect(systems)


@pytest.mark.parametrize("name", sorted(TRUTH))
def test_only_who_is_declared_to_see_the_truth_gets_it(name):

    def systems(*names):
        ports = {"outputs": [name]}, {"inputs": [name]}, {"inputs": [name]}
        made = dict(zip(("world", "logger", "tracker"), ports, strict=True))
        return {each: Ports(**made[each]) for each in names}

    for optional in ([], [name]):  # not even if the tracker could do without it
        with pytest.raises(ValueError, match=f"tracker has an input '{name}', which is the truth"):
            connect(systems("world", "logger", "tracker"), sees_truth=["logger"], optional=optional)
    allowed = systems("world", "logger")
    context = connect(allowed, sees_truth=["logger"]).CreateDefaultContext()
    logger = allowed["logger"]
    assert logger.GetInputPort(name).Eval(logger.GetMyContextFromRoot(context)) == "world"
