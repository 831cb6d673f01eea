from dataclasses import replace

import numpy as np
from synthetic_volumes import Scene, entry_on_side

from sonoservo.systems.localization.line_search import bright_lines

BALLS = [([0.005, 0.06, 0.008], 2e-3), ([-0.01, 0.035, -0.004], 1.5e-3)]
RODS = [([-0.015, 0.07, 0.0], [-0.003, 0.072, 0.008])]
ENTRY = entry_on_side()
K = np.array([0.92, 0.25, 0.3]) / np.linalg.norm([0.92, 0.25, 0.3])
NEEDLE = (ENTRY, ENTRY + 0.035 * K)


def tilt(line):
    """Cosine of the angle between a line found and the needle."""
    k = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    return abs(k @ K)


def test_the_needle_is_the_most_prominent_line():
    scene = Scene(seed=5, spacing=1e-3, balls=BALLS, rods=RODS)
    lines = bright_lines(scene.volume(1, lambda time: NEEDLE))
    assert tilt(lines[0]) > np.cos(np.radians(10))


def test_the_bottom_of_the_tissue_is_no_line():
    volume = Scene(seed=5, spacing=1e-3, balls=BALLS).volume(1, lambda time: NEEDLE)
    depth = volume.origin[1] + volume.spacing[1] * np.arange(volume.intensities.shape[1])
    beneath = (depth > 0.07)[np.newaxis, :, np.newaxis] & (volume.intensities > 0)
    volume = replace(volume, intensities=np.where(beneath, np.uint8(1), volume.intensities))
    lines = bright_lines(volume)
    assert tilt(lines[0]) > np.cos(np.radians(10))
    assert np.abs(lines[0][:, 1].mean() - 0.5 * (NEEDLE[0] + NEEDLE[1])[1]) < 5e-3


def test_no_more_lines_than_asked_for():
    volume = Scene(seed=5, spacing=1e-3).volume(1, lambda time: NEEDLE)
    assert len(bright_lines(volume, count=2)) == 2


def test_a_volume_without_content_holds_no_line():
    volume = Scene(seed=5, spacing=1e-3).volume(1)
    assert bright_lines(replace(volume, intensities=np.zeros_like(volume.intensities))) == []
