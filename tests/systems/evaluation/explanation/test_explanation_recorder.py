from explanations import empty_look, estimate, small_volume
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator

from sonoservo.systems.evaluation import ExplanationRecorder, read_explanations
from sonoservo.systems.evaluation.explanation.explained_volume import FOLDER
from sonoservo.systems.signals import NotFound, TrackingMode

COASTING, SEARCHING = TrackingMode.COASTING, TrackingMode.SEARCHING
NOTHING = NotFound("nothing was looked for")


class Bench:
    """A recorder and a context of it, given one volume after the other."""

    def __init__(self, folder, **options):
        self.recorder = ExplanationRecorder(folder=folder, **options)
        self.context = self.recorder.CreateDefaultContext()

    def fix(self, port, value):
        self.recorder.GetInputPort(port).FixValue(self.context, Value[object](value))

    def see(self, time, after, **more):
        given = {"volume": small_volume(time), "estimate": after}
        given["explanation"] = empty_look(time, NOTHING)
        for port, value in (given | more).items():
            self.fix(port, value)
        self.recorder.ForcedPublish(self.context)


def occasions(folder):
    return [(float(each.volume_time), str(each.occasion)) for each in read_explanations(folder)]


def test_volumes_around_a_change_of_mode_are_kept_until_the_next_run_begins(tmp_path):
    bench = Bench(tmp_path, before=2, after=1)
    for time in range(5):
        bench.see(time, estimate(time, SEARCHING), detection=NotFound("nothing moved"))
        assert [path.name for path in tmp_path.rglob("*")] == [FOLDER]
    bench.see(5, estimate(5))
    assert occasions(tmp_path) == [(3, "before"), (4, "before"), (5, "searching to tracking")]
    bench.see(6, estimate(6))
    bench.see(7, estimate(7))
    bench.see(8, estimate(8))
    assert occasions(tmp_path)[3:] == [(6, "after")]
    bench.see(9, estimate(9, COASTING))
    bench.see(10, estimate(10))
    bench.see(11, estimate(11))
    assert occasions(tmp_path)[4:] == [
        (7, "before"),
        (8, "before"),
        (9, "tracking to coasting"),
        (10, "coasting to tracking"),
        (11, "after"),
    ]
    kept = read_explanations(tmp_path)[3]
    assert (kept.mode_before, kept.mode_after, kept.before_time) == ("tracking", "tracking", 5)
    Simulator(bench.recorder, bench.context).Initialize()  # it looks at once
    assert occasions(tmp_path) == [(11, "first volume")]


def test_a_volume_counts_once_and_only_once_it_was_tracked_in(tmp_path):
    bench = Bench(tmp_path, before=5)
    bench.see(0, estimate(0, SEARCHING), volume=NotFound("no sweep is complete"))
    bench.see(1, estimate(0, SEARCHING))  # the tracker has yet to look at it
    bench.see(1, estimate(1, SEARCHING))
    bench.see(1, estimate(1, SEARCHING))
    bench.see(2, estimate(2, SEARCHING), explanation=NotFound("the tracker does not explain"))
    bench.see(3, estimate(3))
    assert occasions(tmp_path) == [(1, "before"), (3, "searching to tracking")]
