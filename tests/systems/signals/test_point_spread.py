from dataclasses import replace

import numpy as np
import pytest

from sonoservo.systems.signals.point_spread import FWHM_PER_SIGMA, PointSpread
from sonoservo.systems.signals.sweep import SweepGeometry, blur_covariance

GEOMETRY = SweepGeometry(0.04, 0.027, 0.02, 0.03, 1e-3, 40, 11, 80, 0.01)
SPREAD = PointSpread([0.0, 0.08], [1e-3, 3e-3], [5e-3, 5e-3], [0.4e-3, 0.4e-3])


@pytest.mark.parametrize(("k", "j", "i"), [(5, 19.5, 30), (9, 33, 12)])
def test_elsewhere_they_follow_line_and_frame(k, j, i):
    """Along a line, from line to line and from frame to frame, differences of positions tell."""
    step = 1e-4
    p_P = GEOMETRY.position(k, j, i, 1)
    (covariance,) = blur_covariance(SPREAD, GEOMETRY, p_P[np.newaxis])
    along = GEOMETRY.position(k, j, i + step, 1) - p_P
    across = GEOMETRY.position(k + step, j, i, 1) - p_P
    along, across = along / np.linalg.norm(along), across / np.linalg.norm(across)
    widths = [
        FWHM_PER_SIGMA * np.sqrt(axis @ covariance @ axis)
        for axis in (np.cross(along, across), across, along)
    ]
    depth = i * GEOMETRY.sample_pitch
    np.testing.assert_allclose(widths, [1e-3 + depth / 40, 5e-3, 0.4e-3], rtol=1e-3)


@pytest.mark.parametrize(("field", "value"), [("depth", [0.08, 0.0]), ("axial", [0.0, 1e-3])])
def test_bad_widths_are_refused(field, value):
    with pytest.raises(ValueError, match=f"{field}: .* must be"):
        replace(SPREAD, **{field: value})
