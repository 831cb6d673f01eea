from functools import partial

import numpy as np
from pydrake.common.value import Value
from synthetic_volumes import Scene, entry_on_side

from sonoservo.systems.signals import NeedleCurve, NeedlePrediction, NotFound
from sonoservo.systems.tracking import NeedleLocalizer, NeedleLocalizerParameters
from sonoservo.systems.tracking.pipeline import explain_localization

ENDS = entry_on_side() + np.outer([0, 0.03], [0.96, 0.24, 0.1])


class Bench:
    """The leaf with its inputs in hand."""

    def __init__(self):
        self.localizer = NeedleLocalizer(
            localize=partial(explain_localization, parameters=NeedleLocalizerParameters())
        )
        self.context = self.localizer.CreateDefaultContext()
        self.fix("prediction", self.prediction())

    def prediction(self):
        curve = NeedleCurve(ENDS)
        return NeedlePrediction(2, 0.0, curve, np.zeros((2, 3)), 1e-6 * np.eye(6), curve.entry)

    def fix(self, port, value):
        self.localizer.GetInputPort(port).FixValue(self.context, Value[object](value))

    def output(self, port):
        return self.localizer.GetOutputPort(port).Eval(self.context)


def test_says_what_is_missing():
    bench = Bench()
    for port in ("measurement", "explanation"):
        bench.fix("volume", NotFound("no sweep"))
        assert bench.output(port).reason == "no sweep"
    bench.fix("volume", Scene(seed=5, spacing=1e-3).volume(1))
    bench.fix("prediction", NotFound("nothing is expected"))
    assert bench.output("measurement").reason == "nothing is expected"
    assert bench.output("explanation").attempts == ()
