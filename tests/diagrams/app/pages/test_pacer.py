import time
from contextlib import closing

import pytest

from sonoservo.diagrams.app.pages.pacer import Pacer, RealTime
from sonoservo.systems.display import Console


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def test_it_tells_the_speed_of_late(clock):
    real_time = RealTime(window=3.0, clock=clock)
    simulated = 0.0
    assert real_time.factor is None
    for factor in (1.0, 0.5):
        for _ in range(100):
            clock.now += 0.05
            simulated += factor * 0.05
            real_time.is_late(simulated)
        assert real_time.factor == pytest.approx(factor)


def test_a_short_delay_is_made_up_for_a_long_one_forgiven(clock):
    real_time = RealTime(patience=0.5, clock=clock)
    clock.now += 0.4
    assert not real_time.is_late(0.0)
    clock.now += 0.2
    assert real_time.is_late(0.0)
    clock.now += 0.4
    assert not real_time.is_late(0.0)
    clock.now += 10
    real_time.start(0.0)
    assert not real_time.is_late(0.0)
    assert real_time.factor is None


def test_a_run_does_not_hurry_after_what_held_it_up():
    with closing(Console(title="a test", world=None)) as console:
        pacer = Pacer(console)
        assert not pacer.wait(0.0)
        time.sleep(0.6)  # a kernel is compiled
        assert pacer.wait(0.1)
        assert not pacer.wait(0.1)
