import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.robot.probe_stepper import ProbeStepper

X_WP = RigidTransform(RotationMatrix.MakeXRotation(0.3), [0.1, 0.0, 0.2])


def poses(stepper, times):
    context = stepper.CreateDefaultContext()
    out = []
    for time in times:
        context.SetTime(time)
        values = [stepper.GetOutputPort(name).Eval(context) for name in ("X_WP", "X_WT")]
        out.append([RigidTransform(each) for each in values])  # values change in place
    return out


def test_steps_along_its_own_z_and_rests_after_the_last():
    stepper = ProbeStepper(X_WP=X_WP, step=0.5e-3, period=0.05, steps=10)
    moved = [
        X_WP.InvertAndCompose(RigidTransform(X)).translation()
        for X, _ in poses(stepper, [0.0, 0.049, 0.05, 0.1499999999, 0.5, 9.0])
    ]
    assert np.allclose(np.array(moved)[:, 2], [0, 0, 0.5e-3, 1.5e-3, 5e-3, 5e-3])
    assert np.allclose(np.array(moved)[:, :2], 0, atol=1e-15)


def test_the_tissue_shifts_across_the_insertion_by_the_stated_amount():
    stepper = ProbeStepper(X_WP=X_WP, step=1e-3, period=1.0, steps=400, tissue_shift=0.1e-3, seed=3)
    shifts = np.array([X_WT.translation() for _, X_WT in poses(stepper, np.arange(401) + 0.5)])
    in_probe = shifts @ X_WP.rotation().matrix()
    assert np.allclose(in_probe[:, 2], 0, atol=1e-15)
    assert in_probe[:, :2].std() == pytest.approx(0.1e-3, rel=0.1)


def test_breathing_shifts_the_tissue_slowly_and_along_one_direction():
    stepper = ProbeStepper(
        X_WP=X_WP, step=1e-3, period=0.05, steps=200, breathing=1e-3, breathing_period=4.0, seed=2
    )
    times = 0.05 * np.arange(201) + 0.02
    shifts = np.array([X_WT.translation() for _, X_WT in poses(stepper, times)])
    values = np.linalg.svd(shifts)[1]
    assert values[1] < 1e-9 * values[0]
    size = np.linalg.norm(shifts, axis=1)
    assert 0.98e-3 < size.max() <= 1e-3
    assert np.allclose(size[80:], size[:-80], atol=1e-9)
    assert np.abs(np.diff(size)).max() < 0.05e-3


@pytest.mark.parametrize("changes", [{"step": 0.0}, {"steps": 0}, {"tissue_shift": -1e-4}])
def test_bad_values_are_named(changes):
    with pytest.raises(ValueError, match=next(iter(changes))):
        ProbeStepper(**{"X_WP": X_WP, "step": 1e-3, "period": 0.1, "steps": 5, **changes})
