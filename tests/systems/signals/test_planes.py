from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sonoservo.systems.signals import NeedleCurve, Plane, sample_plane, sample_sector, slice_planes

inside = st.tuples(st.floats(-0.05, 0.05), st.floats(0.005, 0.08), st.floats(-0.035, 0.035))
anywhere = st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))
with_fixtures = settings(
    max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def zeros(p_P):
    return np.zeros(p_P.shape[:-1])


def ramp(p_P):
    return 100 + p_P @ [400.0, -300.0, 500.0]


def curve_in_world(volume, *points):
    return NeedleCurve(points).transformed(volume.X_WP)


@given(tip=inside, entry=anywhere)
@with_fixtures
def test_planes_contain_the_needle_and_are_orthogonal(make_volume, tip, entry):
    volume = make_volume(zeros)
    if np.linalg.norm(np.subtract(tip, entry)) < 1e-3:
        return
    planes = slice_planes(volume, curve_in_world(volume, entry, tip))
    assert len(planes) == 2
    for plane in planes:
        for point in (tip, entry):
            assert plane.X_PS.inverse().multiply(np.array(point))[2] == pytest.approx(0, abs=1e-6)
    first, second = (plane.X_PS.rotation().matrix() for plane in planes)
    assert first[:, 2] @ second[:, 2] == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(first[:, 1], [0, 1, 0], atol=1e-9)  # the beam runs down the picture


@given(tip=inside, entry=anywhere, data=st.data())
@with_fixtures
def test_rectangles_hold_the_whole_cut_and_touch_it(make_volume, tip, entry, data):
    volume = make_volume(zeros)
    if np.linalg.norm(np.subtract(tip, entry)) < 1e-3:
        return
    for plane in slice_planes(volume, curve_in_world(volume, entry, tip)):
        # A fine grid on a far larger rectangle: what lies in the volume lies in the small one.
        p_P = Plane(plane.X_PS, 0.5, 0.5).grid(160, 160).reshape(-1, 3)
        held = ((p_P >= volume.origin) & (p_P <= volume.upper)).all(axis=1)
        p_S = plane.X_PS.inverse().multiply(p_P[held].T)
        size = np.array([plane.width, plane.height])
        assert (np.abs(p_S[:2]).max(axis=1) <= 0.5 * size + 1e-9).all()
        if np.min(size) > 0.03:  # not a corner cut off, between the points of the grid
            assert (p_S[:2].max(axis=1) - p_S[:2].min(axis=1) >= size - 0.03).all()


def test_a_plane_that_misses_the_volume_is_left_out(make_volume):
    volume = make_volume(zeros)
    curve = curve_in_world(volume, [-0.1, 0.05, 0.2], [0.1, 0.05, 0.2])
    (plane,) = slice_planes(volume, curve)
    assert plane.X_PS.translation()[1] == pytest.approx(0.05)
    far = curve_in_world(volume, [-0.1, 0.5, 0.2], [0.1, 0.5, 0.2])
    assert slice_planes(volume, far) == []


def test_a_slice_through_a_ramp_is_a_ramp(make_volume):
    volume = make_volume(ramp, dtype=np.float32)
    curve = curve_in_world(volume, [-0.04, 0.02, -0.01], [0.02, 0.05, 0.01])
    for plane in slice_planes(volume, curve):
        picture = sample_plane(volume, plane, 1e-3)
        assert picture.shape == tuple(np.ceil([plane.height / 1e-3, plane.width / 1e-3]))
        p_P = plane.grid(*picture.shape)
        held = ((p_P >= volume.origin) & (p_P <= volume.upper)).all(axis=-1)
        error = picture[held] - ramp(p_P[held])
        assert np.abs(error).max() <= 0.51  # rounded to whole grey levels


def test_only_the_sector_is_opaque(make_volume, geometry):
    volume = make_volume(zeros)
    plane = slice_planes(volume)[0]
    grey, opaque = np.moveaxis(sample_sector(volume, plane, 1e-3), -1, 0)
    np.testing.assert_array_equal(grey, sample_plane(volume, plane, 1e-3))
    p_P = plane.grid(*opaque.shape)
    np.testing.assert_array_equal(opaque == 255, geometry.contains(p_P))
    assert 0 < np.mean(opaque == 255) < 1


def test_planes_without_a_needle_are_those_of_the_probe(make_volume):
    volume = make_volume(zeros)
    lateral, elevation = slice_planes(volume)
    size = volume.upper - volume.origin
    assert (lateral.width, lateral.height) == pytest.approx((size[0], size[1]))
    assert (elevation.width, elevation.height) == pytest.approx((size[2], size[1]))
    assert lateral.X_PS.translation()[2] == pytest.approx(0)
    assert elevation.X_PS.translation()[0] == pytest.approx(0)
    # An array in a corner of the grid shows in no slice.
    unknown = replace(volume, motion=None, origin=np.zeros(3))
    for plane in slice_planes(unknown):
        np.testing.assert_allclose(plane.X_PS.translation(), unknown.upper / 2)
