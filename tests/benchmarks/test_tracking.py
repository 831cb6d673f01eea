"""Detection and tracking on volumes of the paper's size, against what a user would pick instead."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_volumes import ENTRY, Scene

from sonoservo.diagrams.papers.zhao2012.phantom import DIRECTION, TOWARDS, Phantom, StraightNeedle
from sonoservo.diagrams.papers.zhao2012.tracking import BMode, Tracking
from sonoservo.systems.signals import NeedleCurve, NeedlePrediction
from sonoservo.systems.tracking import NeedleLocalizerParameters, localize
from sonoservo.systems.tracking.line_belief import LineBelief, follow

TIP = ENTRY + np.array([0.045, 0.012, 0.005])


def compare(benchmark, name, seconds):
    benchmark.extra_info["compared_with"] = name
    if benchmark.stats is not None:
        benchmark.extra_info["ratio"] = seconds / benchmark.stats.stats.median


@pytest.fixture(scope="module")
def volumes():
    scene = Scene(seed=5)
    return scene.volume(0), scene.volume(2, lambda time: (ENTRY, TIP))


def test_follow(benchmark, volumes):
    before, volume = volumes
    belief = follow(LineBelief(), before)
    after = benchmark(lambda: follow(belief, volume))
    assert after.hypotheses
    compare(benchmark, "the paper's acquisition, 175 ms a volume", 0.175)


@pytest.mark.parametrize("everywhere", [False, True], ids=["predicted", "everywhere"])
def test_localize(benchmark, volumes, everywhere):
    prediction = NeedlePrediction(
        2,
        0.0,
        NeedleCurve([ENTRY, TIP]),
        np.zeros((2, 3)),
        1e-6 * np.eye(6),
        ENTRY,
        everywhere=everywhere,
    )
    parameters = NeedleLocalizerParameters()
    rng = np.random.default_rng(0)
    found = benchmark(lambda: localize(volumes[1], prediction, parameters, rng))
    assert np.linalg.norm(found.curve.tip - TIP) < 3e-3
    compare(benchmark, "the paper's acquisition, 175 ms a volume", 0.175)


def test_zhao_s_tracker_on_a_whole_radio_frequency_volume(benchmark):
    """53 x 71 x 2608 samples: envelope, scan conversion, RANSAC, tip, velocimeter, filter."""
    phantom = Phantom(StraightNeedle(np.array([-7e-3, 0, -12e-3]), DIRECTION), seed=100)
    b_mode = BMode(phantom.renderer.geometry)
    tracker = Tracking(TOWARDS, seed=100)
    sweep = phantom.sweep(15e-3, 0.0)
    number = 0

    def step():
        nonlocal number
        number += 1
        again = replace(sweep, motion=sweep.motion.at_once(float(number)))
        return tracker(again, b_mode(again))

    step()
    found = benchmark(step)
    assert found.measurement
    assert found.velocity
    compare(benchmark, "30 ms, a thirtieth of the acquisition", 0.030)
