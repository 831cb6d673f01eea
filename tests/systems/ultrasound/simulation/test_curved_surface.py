"""The image of a curved body: where its tissue begins, and which lines it is coupled to."""

import numpy as np
import pytest
from renderers import NOWHERE, make_renderer, still

from sonoservo.systems.ultrasound.simulation.structures.kinds import FatLayer
from sonoservo.systems.ultrasound.simulation.tissue import Tissue

# Across a limb: X_P along Y_T, the face 1 mm above the apex.
ACROSS = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, -1, 0, 1e-3], [0, 0, 0, 1.0]])
RADIUS = 0.06
LIMB = Tissue(size=[0.3, 2 * RADIUS, 2 * RADIUS], shape="cylinder", seed=1)


def first_paths(renderer):
    """The way along each line of the middle frame from the face to the limb, in closed form."""
    geometry = renderer.geometry
    middle = geometry.frames // 2
    angles = geometry.line_pitch * (np.arange(geometry.lines) - (geometry.lines - 1) / 2)
    # In the plane across the limb, with the origin on its axis.
    origin = np.stack(
        [
            geometry.array_radius * np.sin(angles),
            RADIUS + 1e-3 + geometry.array_radius * (1 - np.cos(angles)),
        ]
    )
    along = np.stack([np.sin(angles), -np.cos(angles)])
    b = (origin * along).sum(axis=0)
    root = b**2 - (origin**2).sum(axis=0) + RADIUS**2
    return middle, np.where(root > 0, -b - np.sqrt(np.maximum(root, 0)), np.inf)


def test_echoes_begin_at_the_curved_skin():
    renderer = make_renderer(LIMB, frames=3, volume_rate=10.0, frame_pitch_deg=0.1)
    middle, paths = first_paths(renderer)
    envelope = np.abs(renderer.tissue_echo(still(renderer, ACROSS), 1)[middle])
    depths = renderer.geometry.sample_pitch * np.arange(renderer.geometry.samples)
    lines = slice(10, -10, 5)  # the beam is wider than a line
    seen = [float(depths[np.argmax(line > 0.3)]) for line in envelope[lines]]
    off = np.array(seen) - paths[lines]
    assert np.abs(np.median(off)) < 0.8e-3  # of the pulse
    assert np.abs(off).max() < 2.5e-3
    assert np.ptp(paths[lines]) > 5e-3


def test_only_lines_that_the_gel_reaches_are_coupled():
    renderer = make_renderer(LIMB, frames=3, volume_rate=10.0, frame_pitch_deg=0.1, sector=1.0)
    middle, paths = first_paths(renderer)
    grey = renderer.render(still(renderer, ACROSS), [NOWHERE] * 3, 1, 0)[middle].astype(float)
    level = grey[:, 60:160].mean(axis=1)
    assert (level[paths < 3e-3] > 60).all()
    assert (level[paths > 3.7e-3] < 30).all()
    assert (paths < 3e-3).any()
    assert (paths > 3.7e-3).any()


def test_the_middle_of_a_level_and_a_curved_body_look_alike():
    flat = Tissue(size=LIMB.size, seed=1)
    echoes = [
        make_renderer(tissue, frames=3, volume_rate=10.0, frame_pitch_deg=0.1)
        for tissue in (LIMB, flat)
    ]
    X = ACROSS.copy()
    X[2, 3] = -2e-3
    one, other = (each.tissue_echo(still(each, X), 1)[1] for each in echoes)
    depth = int(20e-3 / echoes[0].geometry.sample_pitch)
    lines = slice(one.shape[0] // 2 - 5, one.shape[0] // 2 + 5)
    np.testing.assert_array_equal(one[lines, depth : 2 * depth], other[lines, depth : 2 * depth])


def test_a_curved_body_takes_no_layers_of_a_box():
    with pytest.raises(ValueError, match="shape: 'ellipsoid' .* box with a layer of fat"):
        Tissue(shape="ellipsoid", fat=FatLayer(thickness=0.01))
    with pytest.raises(ValueError, match="shape: 'egg'"):
        Tissue(shape="egg")
