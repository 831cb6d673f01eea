import copy

import numpy as np
import pytest

from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_prediction import NeedlePrediction

CURVE = NeedleCurve([[0, 0, 0], [0.03, 0, 0]])
FIELDS = {"velocity": np.zeros((2, 3)), "covariance": np.eye(6)}


def test_travels_without_a_copy():
    prediction = NeedlePrediction(2, 0.0, CURVE, **FIELDS, entry=np.zeros(3))
    assert prediction
    assert copy.deepcopy(prediction) is prediction
    with pytest.raises(ValueError, match="read-only"):
        prediction.entry[0] = 1.0


def test_nothing_may_be_known_of_a_needle_that_is_localized_everywhere():
    assert NeedlePrediction(3, 0.0, everywhere=True).curve is None
    with pytest.raises(ValueError, match="everywhere"):
        NeedlePrediction(3, 0.0)


@pytest.mark.parametrize(
    ("order", "changes", "message"),
    [
        (3, {}, "curve.order: 2"),
        (2, {"covariance": np.eye(12)}, "covariance"),
        (2, {"velocity": np.zeros((3, 3))}, "velocity"),
        (2, {"entry": np.zeros(2)}, "entry"),
    ],
)
def test_a_curve_of_another_order_is_refused(order, changes, message):
    with pytest.raises(ValueError, match=message):
        NeedlePrediction(order, 0.0, CURVE, **(FIELDS | changes))
