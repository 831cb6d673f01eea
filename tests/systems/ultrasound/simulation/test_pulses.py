"""Rays of lines, held against the geometry that places the samples."""

import numpy as np
import pytest
from renderers import make_renderer

from sonoservo.systems.ultrasound.simulation.pulses import line_rays


@pytest.mark.parametrize("direction", [1, -1])
def test_rays_pass_through_their_samples(direction):
    geometry = make_renderer(frames=5, sector=0.2).geometry
    start, along = line_rays(geometry, direction)
    np.testing.assert_allclose(np.linalg.norm(along, axis=-1), 1)
    frames, lines, samples = np.ogrid[: geometry.frames, : geometry.lines, :200:50]
    expected = geometry.position(frames, lines, samples, direction)
    depths = geometry.sample_pitch * np.arange(0, 200, 50)[:, np.newaxis]
    at = start[:, :, np.newaxis] + depths * along[:, :, np.newaxis]
    np.testing.assert_allclose(at, expected, atol=1e-12)
