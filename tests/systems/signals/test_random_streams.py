import numpy as np
import pytest

from sonoservo.systems.signals.random_streams import random_stream


def test_the_same_is_drawn_again():
    first, second = (random_stream(7, "detection", 1.25).random(5) for _ in range(2))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    "other", [(8, "detection", 1.25), (7, "localization", 1.25), (7, "detection", 1.5)]
)
def test_seeds_purposes_and_volumes_have_streams_of_their_own(other):
    first, second = random_stream(7, "detection", 1.25), random_stream(*other)
    assert abs(np.corrcoef(first.random(2000), second.random(2000))[0, 1]) < 0.1
