from functools import partial

import numpy as np
from pydrake.common.value import Value
from synthetic_volumes import Scene, entry_on_side

from sonoservo.systems.signals import NeedleCurve, NeedleMeasurement, NeedlePrediction, NotFound
from sonoservo.systems.tracking import NeedleLocalizer, NeedleLocalizerParameters
from sonoservo.systems.tracking.pipeline import explain_localization

ENDS = entry_on_side() + np.outer([0, 0.03], [0.96, 0.24, 0.1])


def test_leaf_measures_and_explains_or_says_what_is_missing():
    parameters = NeedleLocalizerParameters()
    localizer = NeedleLocalizer(localize=partial(explain_localization, parameters=parameters))
    context = localizer.CreateDefaultContext()

    def outputs(volume, prediction):
        for name, value in (("volume", volume), ("prediction", prediction)):
            localizer.GetInputPort(name).FixValue(context, Value[object](value))
        ports = map(localizer.GetOutputPort, ("measurement", "explanation"))
        return [port.Eval(context) for port in ports]

    curve = NeedleCurve(ENDS)
    expected = NeedlePrediction(2, 0.0, curve, np.zeros((2, 3)), 1e-6 * np.eye(6), curve.entry)
    volume = Scene(seed=5, spacing=1e-3).volume(1, lambda time: ENDS)
    found, explanation = outputs(volume, expected)
    assert isinstance(found, NeedleMeasurement)
    assert explanation.measurement is found
    assert explanation.attempts
    for output in outputs(NotFound("no sweep"), expected):
        assert output.reason == "no sweep"
    found, explanation = outputs(volume, NotFound("nothing is expected"))
    assert found.reason == "nothing is expected"
    assert explanation.attempts == ()
