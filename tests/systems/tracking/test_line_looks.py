"""What lines look like, held against levels that are known exactly."""

import numpy as np
import pytest
from pydrake.math import RigidTransform

from sonoservo.systems.signals import Volume
from sonoservo.systems.tracking import line_looks as module
from sonoservo.systems.tracking.line_looks import line_looks

PITCH = 0.5e-3
SHAPE = (101, 81, 61)
ENDS = np.array([[5e-3, 20e-3, 15e-3], [40e-3, 20e-3, 15e-3]])
TISSUE, LINE = 100.0, 170.0  # levels; a quarter of a decibel each


def volume(level):
    """Volume whose level is a function of the depth below the line and of the place beside it."""
    x, y, z = PITCH * np.stack(np.indices(SHAPE))
    levels = np.broadcast_to(level(y - ENDS[0, 1], z - ENDS[0, 2], x), SHAPE)
    return Volume(
        intensities=np.round(levels).astype(np.uint8),
        origin=np.zeros(3),
        spacing=np.full(3, PITCH),
        X_WP=RigidTransform(),
        time=0.0,
        decibels_per_level=0.25,
    )


def features(level, ends=ENDS):
    given = {"evidence": [30.0], "entry_gap": [4e-3], "tip_gap": [4e-3]}
    given = {name: np.array(value) for name, value in given.items()}
    found = line_looks(volume(level), ends[np.newaxis], clutter=15.0, **given)
    return {name: float(value[0]) for name, value in found.items()}


def line(below, aside, x=0.0):
    """A bright line of 1.5 mm in even tissue."""
    return np.where(np.hypot(below, aside) < 0.8e-3, LINE, TISSUE)


@pytest.fixture
def blur(monkeypatch):
    """Set the standard deviations of a point's echo along X, Y and Z in m; 0.6 mm at first."""

    def choose(*std):
        covariance = np.diag(np.square(std))
        monkeypatch.setattr(
            module, "echo_covariance", lambda volume, p_P: np.stack(len(p_P) * [covariance])
        )

    choose(0.6e-3, 0.6e-3, 0.6e-3)
    return choose


def test_a_line_in_even_tissue_is_narrow_and_alike_on_all_sides(blur):
    found = features(line)
    assert found["width"] < 0.95
    assert found["aside"] < 10 ** (-10 / 20)
    assert found["around"] == pytest.approx(found["aside"], rel=0.1)
    assert found["entry gap"] == pytest.approx(0.5)
    assert found["behind"] == found["border"] == found["evidence"] == found["fall"] == 0
    assert found["tip at edge"] == pytest.approx(np.exp(-1))
    assert found["rim"] == 0


def test_a_sheet_is_wide_and_as_bright_beside(blur):
    found = features(lambda below, aside, x: np.where(np.abs(below) < 0.8e-3, LINE, TISSUE))
    assert found["width"] == pytest.approx(1.4)
    assert found["aside"] == pytest.approx(found["around"])
    assert found["aside"] > 0.8


@pytest.mark.parametrize(("drop", "border"), [(4.0, 0.0), (8.0, 1.0), (12.0, 4.0), (24.0, 9.0)])
def test_border_is_the_darkness_below(drop, border):
    found = features(
        lambda below, aside, x: line(below, aside) - 4 * drop * (below > 1.5e-3)
    )  # four levels a decibel
    assert found["border"] == pytest.approx(border, abs=0.15)


def test_what_brightens_below_is_behind():
    found = features(lambda below, aside, x: line(below, aside) + 16.0 * (below > 3e-3))
    assert found["behind"] == pytest.approx(2.0, abs=0.1)
    assert found["border"] == 0


@pytest.mark.parametrize(("length", "short"), [(35e-3, 0.0), (20e-3, 0.0), (10e-3, 0.5)])
def test_short_lines_are_told(length, short):
    ends = ENDS[0] + np.outer([0, length], [1.0, 0.0, 0.0])
    assert features(line, ends)["short"] == pytest.approx(short)


def test_a_width_is_relative_to_the_larger_blur_across_the_line(blur):
    plain = features(line)["width"]
    blur(5e-3, 0.6e-3, 0.6e-3)  # along the line
    assert features(line)["width"] == pytest.approx(plain)
    blur(0.6e-3, 0.6e-3, 0.9e-3)
    expected = plain * np.hypot(0.6, 0.45) / np.hypot(0.9, 0.45)
    assert features(line)["width"] == pytest.approx(expected)
