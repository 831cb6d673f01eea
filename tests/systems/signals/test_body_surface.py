import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sonoservo.systems.signals import BodySurface

BOX = BodySurface([0.24, 0.16, 0.08])
LIMB = BodySurface([0.3, 0.12, 0.12], "cylinder")
ABDOMEN = BodySurface([0.32, 0.24, 0.12], "ellipsoid")


def line(azimuth_deg, dip_deg):
    azimuth, dip = np.deg2rad([azimuth_deg, dip_deg])
    return np.array([np.cos(dip) * np.cos(azimuth), np.cos(dip) * np.sin(azimuth), -np.sin(dip)])


def test_the_top_of_a_cylinder_is_an_arc():
    for y in (-0.03, 0.0, 0.02):
        assert LIMB.height(0.1, y) == pytest.approx(np.sqrt(0.06**2 - y**2) - 0.06)
        normal = LIMB.normal([0.1, y, LIMB.height(0.1, y)])
        np.testing.assert_allclose(normal, [0, y / 0.06, np.sqrt(1 - (y / 0.06) ** 2)], atol=1e-12)


def test_an_ellipsoid_s_normal_stands_on_its_top():
    x, y, step = 0.05, -0.04, 1e-6
    z = ABDOMEN.height(x, y)
    slopes = [(ABDOMEN.height(x + step, y) - z) / step, (ABDOMEN.height(x, y + step) - z) / step]
    normal = ABDOMEN.normal([x, y, z])
    np.testing.assert_allclose(normal[:2] / normal[2], np.negative(slopes), rtol=1e-4)


@given(
    azimuth=st.floats(0, 360), dip=st.floats(-90, 90), shape=st.sampled_from([BOX, LIMB, ABDOMEN])
)
def test_every_entry_is_on_the_surface_and_every_line_then_inside(azimuth, dip, shape):
    aim, along = np.array([0.01, -0.01, -0.04]), line(azimuth, dip)
    entry = shape.entry(aim, along)
    np.testing.assert_allclose(np.cross(aim - entry, along), 0, atol=1e-12)
    way = np.linalg.norm(aim - entry)
    assert shape.contains(entry + np.outer(np.linspace(0, way, 9), along)).all()
    assert not shape.contains(entry - 1e-5 * along)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="shape: 'ball' .* box, cylinder, ellipsoid"):
        BodySurface([0.1, 0.1, 0.1], "ball")
    with pytest.raises(ValueError, match="size: .* equal along Y and Z"):
        BodySurface([0.3, 0.12, 0.1], "cylinder")
    with pytest.raises(ValueError, match=r"y 0.060 m is not on top of a cylinder"):
        LIMB.height(0.0, 0.06)
    with pytest.raises(ValueError, match="aim: .* in the phantom, a cylinder"):
        LIMB.entry([0, 0.05, 0], line(0, 0))
