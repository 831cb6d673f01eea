import numpy as np
import pytest

from sonoservo.systems.recording.grey_levels import GreyLevels

ECHOES = np.random.default_rng(0).normal(1000, 300, (20, 20, 20)).astype(np.int16)


def test_blank_volumes_choose_nothing_and_are_black():
    grey = GreyLevels()
    for _ in range(3):
        assert not grey(np.zeros_like(ECHOES)).any()
    assert grey.window is None
    grey(ECHOES)
    assert grey.window.high == pytest.approx(ECHOES.max(), rel=0.1)


@pytest.mark.parametrize("first", [1 / 8, 8])
def test_window_follows_a_first_volume_of_other_brightness(first):
    """At once where the numbers would saturate; after eight volumes where they would be dark."""
    grey = GreyLevels()
    grey((first * ECHOES).astype(np.int16))
    for _ in range(1 if first < 1 else 8):
        levels = grey(ECHOES)
    assert (levels == 255).mean() < 0.02
    assert levels.max() > 200
