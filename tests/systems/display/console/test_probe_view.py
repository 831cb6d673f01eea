import numpy as np
import pytest
from packed_scene import boxes, transform, visible

from sonoservo.systems.display import Site
from sonoservo.systems.display.console.probe_view import ProbeView
from sonoservo.systems.signals import NeedleCurve, NeedleEstimate, TrackingMode, slice_planes

ENTRY, TIP = np.array([-0.03, 0.03, -0.02]), np.array([0.01, 0.05, 0.01])


class Page:
    """The view on a site, and what it would send, asked for on the site's thread."""

    def __init__(self, site):
        self._site, self._view = site, ProbeView(site)

    def show(self, volume, estimate=None):
        self._site.ask(lambda: self._view.show(volume, estimate))

    def ask(self, function, path):
        return self._site.ask(lambda: function(self._view._meshcat, f"probe/{path}"))


@pytest.fixture
def page():
    with Site() as site:
        yield Page(site)


def grey(p_P):
    return 100 + 1000 * p_P[..., 0]


def estimate(volume, mode=TrackingMode.TRACKING, points=(ENTRY, TIP)):
    curve = NeedleCurve(points).transformed(volume.X_WP)
    n = len(points)
    return NeedleEstimate(mode, volume.time, curve, np.zeros((n, 3)), np.eye(6 * n), volume.time)


def test_slices_and_needle_are_where_they_are_in_the_probe(page, make_volume):
    volume = make_volume(grey)
    found = estimate(volume)
    page.show(volume, found)
    planes = slice_planes(volume, found.curve)
    for plane, box in zip(planes, page.ask(boxes, "slices"), strict=True):
        corners = plane.grid(2, 2).reshape(-1, 3) - plane.X_PS.translation()
        corners = plane.X_PS.translation() + 2 * corners  # of the picture, not of its pixels
        np.testing.assert_allclose(box, [corners.min(axis=0), corners.max(axis=0)], atol=1e-6)
    assert page.ask(visible, "needle")
    # The depth runs down, about the middle of the volume.
    X = page.ask(transform, "")
    np.testing.assert_allclose(X @ [0, 1, 0, 0], [0, 0, -1, 0], atol=1e-9)
    middle = 0.5 * (volume.origin + volume.upper)
    np.testing.assert_allclose(X @ [*middle, 1], [0, 0, 0, 1], atol=1e-9)


def test_what_cannot_be_seen_is_hidden(page, make_volume):
    volume = make_volume(grey)
    page.show(volume, estimate(volume))
    page.show(volume, NeedleEstimate(TrackingMode.SEARCHING, 0.0))
    assert page.ask(visible, "slices")
    assert not page.ask(visible, "needle")
    page.show(volume, estimate(volume, points=(ENTRY + 1.0, TIP + 1.0)))
    assert not page.ask(visible, "slices")  # their planes miss the volume
    size = lambda meshcat, path: len(meshcat._GetPackedObject(path))  # noqa: E731
    sector = page.ask(size, "outline")
    page.show(make_volume(grey, motion=False))
    assert page.ask(size, "outline") < sector  # that of the grid
