"""Dials drawn for a data set, and where a needle appears in tissue that moves or slows sound."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform

from sonoservo.diagrams import load_scenario
from sonoservo.diagrams.dials import load_dials
from sonoservo.diagrams.studies.datasets.dataset_draws import draw_dials
from sonoservo.diagrams.studies.datasets.dataset_sequence import needle_as_imaged
from sonoservo.systems.signals import Needle
from sonoservo.systems.ultrasound import ImagingParameters, load_transducer, sweep_geometry

SEEN = {
    "structure beside the needle", "faint needle", "fading needle", "dip", "speed", "drag",
    "pushed aside", "indentation", "breathing", "speed of sound", "backlash", "air pockets",
    "friction",
}  # fmt: skip


def test_every_dial_that_shows_is_drawn_about_as_often_and_as_far():
    drawn = [draw_dials(np.random.default_rng(seed)) for seed in range(300)]
    names = [name for each in drawn for name in each.strengths]
    assert set(names) == SEEN <= load_dials().keys()
    free = SEEN - {"structure beside the needle", "speed of sound", "friction"}
    assert all(0.4 < names.count(name) / len(drawn) < 0.6 for name in free)
    strengths = [strength for each in drawn for strength in each.strengths.values()]
    assert 0.1 <= min(strengths) < 0.15
    assert 0.95 < max(strengths) <= 1
    assert max(each.max_dip_deg for each in drawn) > 50
    assert all(each.max_dip_deg >= 30 and each.max_speed >= 12e-3 for each in drawn)
    assert all(sum(c.startswith("phantom=") for c in each.changes) <= 1 for each in drawn)
    for each in drawn[:20]:
        load_scenario("chatelain2013_fig5", changes=list(each.changes))


@pytest.fixture
def geometry():
    return sweep_geometry(load_transducer("4dc7_3_40"), ImagingParameters())


@pytest.fixture
def needle():
    return Needle(np.array([[-15e-3, 35e-3, -4e-3], [15e-3, 45e-3, 6e-3]]), 0.5e-3)


def test_in_slow_tissue_it_appears_deeper(geometry, needle):
    poses = np.tile(np.eye(4), (geometry.frames, 1, 1))
    slow = replace(geometry, sample_pitch=0.95 * geometry.sample_pitch, sound_speed=1463.0)
    shown = needle_as_imaged(needle, poses, None, slow, geometry, 1)
    for true, seen in zip(needle.shaft, shown.shaft[[0, -1]], strict=True):
        k, j, i = geometry.index(true, 1)
        np.testing.assert_allclose(geometry.index(seen, 1), (k, j, i / 0.95), rtol=1e-9)
        assert seen[1] > 1.04 * true[1]


@pytest.mark.parametrize("direction", [1, -1])
def test_each_point_appears_where_its_own_frame_saw_it(geometry, needle, direction):
    away = np.linspace(-1e-3, 1e-3, geometry.frames)[::direction]
    poses = np.array([RigidTransform([x, 0, 0]).GetAsMatrix4() for x in away])
    shown = needle_as_imaged(needle, poses, None, geometry, geometry, direction)
    k = np.diff(needle.shaft, axis=0)[0]
    k /= np.linalg.norm(k)
    for point in shown.shaft:
        frame = int(np.rint(geometry.index(point, direction)[0]))
        in_tissue = point + np.array([away[frame], 0, 0])
        off = in_tissue - needle.shaft[0]
        off -= (k @ off) * k
        np.testing.assert_allclose(off, 0, atol=2e-5)
