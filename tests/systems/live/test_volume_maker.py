import numpy as np
import pytest
from live_items import X
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.live.connection.items import ImageItem
from sonoservo.systems.live.image_matcher import PosedImage
from sonoservo.systems.live.volume_maker import VolumeMaker


def posed(item, X_WL=None, acquisition=None, time=1.0):
    return PosedImage(item, X_WL or RigidTransform(), acquisition, time, 0.0)


def image(voxels, R=None, origin=(0, 0, 0), steps=(1e-3, 1e-3, 1e-3)):
    X_LI = np.eye(4)
    X_LI[:3, :3] = (np.eye(3) if R is None else R) * steps
    X_LI[:3, 3] = origin
    return ImageItem("Image", 1.0, voxels, X_LI)


VOXELS = np.random.default_rng(0).integers(0, 255, (5, 4, 3), dtype=np.uint8)


@pytest.mark.parametrize("order", [(2, 0, 1), (0, 2, 1)], ids=str)
@pytest.mark.parametrize("sign", [1, -1])
def test_axes_in_any_order_and_sign_are_the_same_volume(order, sign):
    """The voxel at a place in L is there, however its array is stored."""
    R = np.eye(3)[:, list(order)] * [sign, 1, sign]
    item = image(VOXELS.transpose(order), R, steps=np.array([1e-3, 2e-3, 3e-3])[list(order)])
    made = VolumeMaker()(posed(item, X))
    i, j, k = 1, 2, 1
    where = np.array([i, j, k])[list(order)]
    p_L = (item.X_LI @ [*where, 1])[:3]
    p_P = made.X_WP.inverse().multiply(X.multiply(p_L))
    index = np.round(made.index(p_P), 6)
    np.testing.assert_array_equal(index, index.round())
    assert made.intensities[tuple(index.astype(int))] == VOXELS[i, j, k]


def test_moved_image_is_a_moved_probe():
    maker = VolumeMaker()
    motion = RigidTransform(RotationMatrix.MakeXRotation(0.2), [0.01, 0.02, 0.03])
    first = image(VOXELS, origin=[0.001, 0.002, 0.003])
    moved = ImageItem("Image", 1.3, VOXELS, motion.GetAsMatrix4() @ first.X_LI)
    start = maker(posed(first))
    assert not maker.posed
    end = maker(posed(moved, time=1.3))
    assert maker.posed
    assert end.X_WP.IsNearlyEqualTo(motion @ start.X_WP, 1e-12)
    np.testing.assert_array_equal(end.origin, start.origin)
    assert maker.X_WL(posed(moved)).IsNearlyEqualTo(motion, 1e-12)


def test_grid_that_changes_is_left_out():
    maker = VolumeMaker()
    maker(posed(image(VOXELS)))
    assert "left out" in maker(posed(image(VOXELS[:-1]))).reason
    assert "not the first one's" in maker(posed(image(VOXELS, steps=[2e-3, 1e-3, 1e-3]))).reason


def test_grey_levels_are_those_of_the_first_volume_or_of_the_window():
    maker = VolumeMaker()
    numbers = np.linspace(-1000, 1000, 60).reshape(5, 4, 3).astype(np.int16)
    made = maker(posed(image(numbers)))
    assert (made.intensities.min(), made.intensities.max()) == (0, 255)
    maker.grey.held = True
    bright = maker(posed(image(4 * numbers)))
    assert np.mean(bright.intensities == 255) == pytest.approx(0.375, abs=0.02)
    fixed = VolumeMaker(window=(0, 1000))(posed(image(numbers)))
    assert np.mean(fixed.intensities == 0) == pytest.approx(0.5, abs=0.02)


def test_oblique_and_infinite_images_are_left_out():
    R = np.eye(3)
    R[0, 1] = 0.5
    assert "right angles" in VolumeMaker()(posed(image(VOXELS, R))).reason
    numbers = VOXELS.astype(np.float32)
    maker = VolumeMaker()
    assert "not finite" in maker(posed(image(np.nan * numbers[:-1]))).reason
    numbers[0, 0, 0] = np.nan
    seen = maker(posed(image(numbers))).seen  # what was refused has decided nothing
    assert np.count_nonzero(~seen) == 1


@pytest.mark.parametrize("steps", [[1e-300, 1e-3, 1e-3], [1e-3, 1.0, 1e-3]])
def test_implausible_grid_is_left_out(steps):
    assert "spacing" in VolumeMaker()(posed(image(VOXELS, steps=steps))).reason


def test_another_scanner_begins_with_its_own_grid():
    maker = VolumeMaker()
    maker(posed(image(VOXELS)))
    other = PosedImage(image(VOXELS[:-1]), RigidTransform(), None, 2.0, 0.0, ("other", "Image"))
    assert maker(other).intensities.size == VOXELS[:-1].size
