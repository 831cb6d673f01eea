"""Another speed of sound than the scanner's, and fat that refracts."""

from dataclasses import replace

import numpy as np
import pytest
from renderers import about, make_renderer
from scipy.optimize import minimize_scalar

from sonoservo.systems.ultrasound.simulation import Tissue
from sonoservo.systems.ultrasound.simulation.kernels.medium import Medium, true_position
from sonoservo.systems.ultrasound.simulation.structures.kinds import FatLayer

ON_TOP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
FAT = FatLayer(thickness=0.015, sound_speed=1450.0, level_db=0.0)


def poses(X=ON_TOP):
    return np.repeat(X[np.newaxis], 27, axis=0)


def seen(tissue, points, X=ON_TOP):
    """Where points of T appear in the middle frame: positions in P, as the scanner takes them."""
    renderer = make_renderer(tissue)
    geometry = renderer.geometry
    found = []
    for point in points:
        iq = np.zeros(geometry.shape, np.complex64)
        renderer.add_scatterers(iq, poses(X), np.array([point]), np.array([1e3 + 0j]), 1)
        level = np.abs(iq[13])
        weights = np.where(level > 0.3 * level.max(), level, 0).astype(float)
        j, i = (np.indices(level.shape) * weights).sum(axis=(1, 2)) / weights.sum()
        found.append(geometry.position(13, j, i, 1))
    return np.array(found)


def test_slow_tissue_appears_deeper_by_the_ratio():
    depths = np.array([0.03, 0.05, 0.07])
    points = np.stack([0 * depths, 0 * depths, -depths], axis=1)
    for speed in (1463.0, 1617.0):
        apparent = seen(Tissue(sound_speed=speed), points)[:, 1]
        assert apparent == pytest.approx(depths * 1540 / speed, abs=0.1e-3)


def medium(ratio, tilt=0.0, thickness=0.015):
    """Fat on a face that is tilted about the elevation's axis; the array's centre is at F's origin
    less the offset."""
    return Medium(
        normals=np.array([[np.sin(tilt), np.cos(tilt), 0.0]]),
        offsets=np.array([0.02725 + thickness]),
        ratio=ratio,
        array_radius=0.04,
        centre_offset=0.01275,
        delays=np.zeros((1, 0, 0), np.float32),
        lines_per_radian=94.0,
        nodes_per_metre=1e3,
    )


@pytest.mark.parametrize(
    ("ratio", "angle_deg", "tilt"),
    [(1450 / 1540, 25, 0.0), (1450 / 1540, 10, 0.1), (1600 / 1540, 30, 0.1)],
)
def test_way_through_fat_takes_the_least_time(ratio, angle_deg, tilt):
    """Fermat: any other point of the face would take longer; the time is the apparent depth's."""
    fat, phi, depth = medium(ratio, tilt), np.deg2rad(angle_deg), 0.06
    start = np.array([0.04 * np.sin(phi), 0.04 * np.cos(phi) - 0.01275])
    ray = np.array([np.sin(phi), np.cos(phi)])
    end = np.array(true_position(*(start + depth * ray), 0.0, fat, 0))[:2]
    normal = fat.normals[0, :2]
    along = np.array([normal[1], -normal[0]])

    def time(s):
        point = fat.offsets[0] * normal + s * along
        return np.linalg.norm(point - start) / ratio + np.linalg.norm(end - point)

    least = minimize_scalar(time, bounds=(start @ along, end @ along), method="bounded").fun
    assert least == pytest.approx(depth, abs=1e-7)


def test_points_appear_where_fat_bends_the_lines_to_them():
    """Below a probe that is turned about the elevation's axis."""
    points = [[0.02, 0, -0.045], [-0.025, 0, -0.06]]
    X = ON_TOP @ about(2, np.deg2rad(12), [0, -0.02725, 0])
    apparent, X_PT = seen(Tissue(fat=FAT), points, X), np.linalg.inv(X)
    normal, motor = -X_PT[:3, 2], np.array([0, 0.02725, 0])
    offset = normal @ (X_PT[:3, 3] - FAT.thickness * X_PT[:3, 2] + motor)
    fat = medium(1450 / 1540)._replace(normals=normal[np.newaxis], offsets=np.array([offset]))
    for point, there in zip(points, apparent, strict=True):
        true = np.array(true_position(*(there + motor), fat, 0)) - motor
        expected = X_PT[:3, :3] @ point + X_PT[:3, 3]
        assert true[:2] == pytest.approx(expected[:2], abs=0.25e-3)
        assert np.abs(there - expected)[:2].max() > 0.7e-3


def test_tissue_and_points_are_bent_alike():
    """Speckle behind fat is that of plain tissue, moved: they correlate where they appear."""
    flat = Tissue(size=[0.24, 0.16, 0.08])
    renderer = make_renderer(flat, sector=0.3)
    plain = renderer.tissue_echo(poses(), 1)[13]
    behind = make_renderer(replace(flat, fat=FAT), sector=0.3).tissue_echo(poses(), 1)[13]
    pitch = renderer.geometry.sample_pitch
    late = FAT.thickness * (1540 / 1450 - 1) / pitch
    a = np.abs(plain[18:21, 100:230]).ravel()
    correlations = [
        np.corrcoef(a, np.abs(behind[18:21, 100 + k : 230 + k]).ravel())[0, 1] for k in range(8)
    ]
    assert abs(int(np.argmax(correlations)) - late) < 1
    assert max(correlations) > 0.7
