"""Memory and looks of a leaf, as every leaf that declares them has them."""

import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem

from sonoservo.systems.signals.leaves import declare_looks, declare_memory


class Notes(LeafSystem):
    """Notes the time of every look."""

    def __init__(self, **looks):
        super().__init__()
        self.memory = declare_memory(self, list)
        look = lambda context: self.memory(context).append(context.get_time())  # noqa: E731
        declare_looks(self, look, start=lambda context: self.memory(context).clear(), **looks)


def test_each_context_remembers_for_itself_and_each_run_begins_anew():
    notes = Notes(period=0.5, offset=0.25)
    first, second = Simulator(notes), Simulator(notes, notes.CreateDefaultContext())
    first.AdvanceTo(1.0)
    second.AdvanceTo(2.0)
    copy = first.get_context().Clone()
    notes.ForcedPublish(copy)
    assert notes.memory(first.get_context()) == [0.25, 0.75]
    assert notes.memory(copy) == [0.25, 0.75, 1.0]
    assert len(notes.memory(second.get_context())) == 4
    first.Initialize()
    assert notes.memory(first.get_context()) == []


@pytest.mark.parametrize(
    ("looks", "message"),
    [({"period": 0}, "period: 0 is not"), ({"period": 1, "offset": -1}, "offset: -1 is not")],
)
def test_periods_and_offsets_are_checked(looks, message):
    with pytest.raises(ValueError, match=message):
        Notes(**looks)
