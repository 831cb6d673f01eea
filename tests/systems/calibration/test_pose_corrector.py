"""The corrector as a block: what it outputs, and when."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from still_tissue import LyingProbe

from sonoservo.systems.calibration import PoseCorrector, PoseErrors
from sonoservo.systems.signals.immutable import NotFound

LYING = LyingProbe(delay=0.06, X_PI=RigidTransform([1e-3, 0.0, 1e-3]))


@pytest.fixture(scope="module")
def volumes():
    return [LYING.volume(number) for number in range(14)]


def give(system, context, volume):
    system.GetInputPort("volume").FixValue(context, Value[object](volume))
    return system.GetOutputPort("volume").Eval(context)


def test_poses_are_corrected_once_errors_are_known(volumes):
    system = PoseCorrector(period=1.0)
    context = system.CreateDefaultContext()
    errors = system.GetOutputPort("pose_errors")
    for volume in volumes:
        known = errors.Eval(context)
        before = give(system, context, volume)
        system.ExecuteForcedEvents(context)
        after = system.GetOutputPort("volume").Eval(context)
        assert after is before  # or a tracker would take it for another volume
        if isinstance(known, PoseErrors):
            np.testing.assert_array_equal(
                before.X_WP.GetAsMatrix4(), known.corrected(volume).X_WP.GetAsMatrix4()
            )
        else:
            assert before is volume
    assert isinstance(errors.Eval(context), PoseErrors)
    assert errors.Eval(context).delay == pytest.approx(0.06, abs=6e-3)


def test_a_repeated_volume_is_not_compared(volumes):
    system = PoseCorrector(period=1.0)
    context = system.CreateDefaultContext()
    for volume in [*volumes[:2], *5 * [volumes[2]]]:
        give(system, context, volume)
        system.ExecuteForcedEvents(context)
    assert "too few" in system.GetOutputPort("pose_errors").Eval(context).reason
    assert system.GetOutputPort("pose_errors").Eval(context).reason[0] in "12"


def test_a_missing_volume_is_passed_on():
    system = PoseCorrector(period=1.0)
    context = system.CreateDefaultContext()
    missing = NotFound("no sweep yet")
    assert give(system, context, missing) is missing
    system.ExecuteForcedEvents(context)
    assert not system.GetOutputPort("pose_errors").Eval(context)
