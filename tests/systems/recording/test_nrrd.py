import nrrd
import numpy as np
import pytest
from pydrake.math import RigidTransform

from sonoservo.systems.recording import Recording, write_volume
from sonoservo.systems.signals import Volume


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_a_marked_voxel_is_read_back_at_the_right_millimetre(tmp_path, dtype):
    intensities = np.zeros((5, 7, 11), dtype)
    intensities[1, 2, 9] = 200
    volume = Volume(
        intensities=intensities,
        origin=[-0.002, 0.010, -0.005],
        spacing=[0.5e-3, 0.7e-3, 1e-3],
        X_WP=RigidTransform([0.1, 0.2, 0.3]),
        time=1.0,
        decibels_per_level=45 / 255,
    )
    path = write_volume(tmp_path / "new" / "scan.nrrd", volume)
    data, header = nrrd.read(str(path))
    assert data.dtype == dtype
    np.testing.assert_array_equal(data, intensities)
    assert header["encoding"] == "gzip"
    assert header["space"] == "left-posterior-superior"
    place = header["space origin"] + np.argwhere(data == 200)[0] @ header["space directions"]
    # L is X of P (along the array), P is Y (depth), S is Z (the sweep).
    np.testing.assert_allclose(place, [-2 + 0.5, 10 + 1.4, -5 + 9])
    np.testing.assert_allclose(place, 1e3 * volume.position([1, 2, 9]))
    assert Recording(path)[0].decibels_per_level == 45 / 255
