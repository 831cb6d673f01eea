"""The gate before the tracker: which volumes are believed, and what tracking makes of the rest."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from synthetic_volumes import Scene

from sonoservo.systems.signals import NotFound, Volume, VolumeCheck
from sonoservo.systems.signals.search_reason import Reader, ReasonCount
from sonoservo.systems.tracking import VolumeGate, VolumePlausibilityParameters
from sonoservo.systems.tracking.volume_plausibility import implausible, mirrored_axis

SCENE = Scene(seed=5, spacing=1.5e-3)
LIMITS = VolumePlausibilityParameters()


@pytest.fixture(scope="module")
def volumes():
    return [SCENE.volume(number) for number in range(8)]


def grey(volume, intensities):
    return replace(volume, intensities=intensities)


def later(volume, seconds):
    return replace(volume, time=volume.time + seconds)


def judge(volume, last=None, refused=None, clock=0.0, lead=0.0):
    return implausible(volume, last, refused, clock, lead, LIMITS)


def test_good_volumes_of_either_direction_are_believed(volumes):
    assert judge(volumes[0]) == ""
    for last, volume in pairwise(volumes):
        assert judge(volume, last, clock=volume.time + 0.2) == ""
    assert judge(volumes[3], volumes[3]) == ""  # repeated


def test_blank_and_white_volumes_are_refused(volumes):
    first, second = volumes[:2]
    shape = second.intensities.shape
    assert "blank" in judge(grey(second, np.zeros(shape, np.uint8)), first)
    assert "blank" in judge(grey(second, np.full(shape, 255, np.uint8)), first)
    white = np.where(second.intensities > 0, 254, 0).astype(np.uint8)
    assert "white" in judge(grey(second, white), first)
    saturated = np.clip(second.intensities * 1.5, 0, 255).astype(np.uint8)
    assert judge(grey(second, saturated), first) == ""


@pytest.mark.parametrize(("axis", "number"), [("X", 0), ("Z", 2)])
def test_mirrored_volumes_are_refused(volumes, axis, number):
    first, _, third = volumes[:3]
    mirrored = grey(third, np.flip(third.intensities, number).copy())
    assert judge(mirrored, first) == f"it looks mirrored along {axis}"
    assert mirrored_axis(mirrored, first, threshold=1.0) == ""
    # Of other tissue, nothing can be known.
    assert mirrored_axis(mirrored, Scene(seed=8, spacing=1.5e-3).volume(0), 0.25) == ""


def test_volumes_out_of_their_time_are_refused(volumes):
    first, second, third = volumes[:3]
    assert "s before that of the volume before" in judge(second, third)
    ahead = later(second, 10.0)
    assert "ahead of the clock" in judge(ahead, first, clock=second.time + 0.2)
    assert "10.3 s after" in judge(ahead, first)
    # One wrong time is not believed, two that agree are.
    assert judge(third, first, refused=ahead) == ""
    assert judge(later(third, 10.0), first, refused=ahead) == ""
    assert judge(later(third, 50.0), first, refused=ahead) != ""


def test_a_scanner_may_have_a_clock_of_its_own(volumes):
    ours = [volume.time + 0.2 for volume in volumes]
    theirs = [later(volume, 1.7e9) for volume in volumes]
    results = list(feed([*theirs[:4], later(theirs[4], 10.0), theirs[5]], ours))
    assert [isinstance(result, Volume) for result, _ in results] == [
        False, True, True, True, False, True,
    ]  # fmt: skip


def test_another_grid_is_believed_if_the_next_volume_confirms_it(volumes):
    first = volumes[0]
    other = Scene(seed=5, spacing=1.2e-3).volume(1)
    again = Scene(seed=5, spacing=1.2e-3).volume(2)
    assert "another grid, with a spacing of 1.2, 1.2, 1.2 mm" in judge(other, first)
    assert judge(again, first, refused=other) == ""
    assert judge(volumes[2], first, refused=other) == ""


def test_a_pose_that_is_no_number_is_refused(volumes):
    lost = replace(volumes[1], X_WP=RigidTransform([np.nan, 0.0, 0.0]))
    assert "pose is not a number" in judge(lost, volumes[0])


def feed(volumes, clock=None):
    """Results and counts after each volume."""
    gate = VolumeGate(period=1.0)
    context = gate.CreateDefaultContext()
    for number, volume in enumerate(volumes):
        if clock is not None:
            context.SetTime(clock[number])
        gate.GetInputPort("volume").FixValue(context, Value[object](volume))
        before = gate.GetOutputPort("volume").Eval(context)
        gate.ExecuteForcedEvents(context)
        after = gate.GetOutputPort("volume").Eval(context)
        assert after is before or after == before
        yield after, gate.GetOutputPort("volume_check").Eval(context)


def test_leaf_passes_good_volumes_untouched_and_counts_the_others(volumes):
    blank = grey(volumes[1], np.zeros_like(volumes[1].intensities))
    fed = [NotFound("no volume"), volumes[0], blank, blank, volumes[2], volumes[1], volumes[3]]
    results = list(feed(fed))
    assert [isinstance(result, Volume) for result, _ in results] == [
        False, True, False, False, True, False, True,
    ]  # fmt: skip
    assert results[1][0] is volumes[0]
    assert results[0][0].reason == "no volume"
    assert "refused: it is blank" in results[2][0].reason
    assert results[3][1].refused == 1  # the same volume, still there
    older = results[5][1].reason
    assert "refused: its time is 0.30 s before that of the volume before it" in older
    assert "--volume-rate" in ReasonCount([older]).advice(Reader.RECORDING)
    assert results[-1][1] == VolumeCheck(accepted=3, refused=2)
