import numpy as np
import pytest

from sonoservo.systems.signals.confidence import confidence_ellipsoid


@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_an_ellipsoid_holds_as_many_normal_samples_as_it_says(probability):
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(3, 3))
    samples = rng.normal(size=(20_000, 3)) @ factor.T
    axes, half_axes = confidence_ellipsoid(factor @ factor.T, probability)
    inside = (((samples @ axes) / half_axes) ** 2).sum(axis=1) < 1
    assert inside.mean() == pytest.approx(probability, abs=0.015)
    assert np.linalg.det(axes) == pytest.approx(1)
    assert not confidence_ellipsoid(np.zeros((3, 3)))[1].any()
    with pytest.raises(ValueError, match="probability: 95 is not allowed"):
        confidence_ellipsoid(np.eye(3), 95)
