"""A shape that a Meshcat draws appears where it is, and nothing goes over the network."""

import numpy as np
from page_clients.browser_view import eventually, project, screenshot, wait_for_object
from pydrake.geometry import Rgba, Sphere
from pydrake.math import RigidTransform


def test_a_ball_is_seen_where_it_is(meshcat, open_page):
    p_W = [-0.3, 0.2, 0.1]
    meshcat.SetProperty("/Background", "visible", False)
    meshcat.SetObject("ball", Sphere(0.04), Rgba(1, 0, 0))
    meshcat.SetTransform("ball", RigidTransform(p_W))
    meshcat.SetCameraPose([1.5, -1.0, 1.0], [0, 0, 0.2])
    page = open_page(meshcat.web_url())
    wait_for_object(page, "/drake/ball")

    def check():
        picture = screenshot(page).astype(int)
        red = (picture[..., 0] > 100) & (picture[..., 1:].max(axis=2) < 60)
        rows, columns = np.nonzero(red)
        assert rows.size > 100
        np.testing.assert_allclose([columns.mean(), rows.mean()], project(page, p_W)[0], atol=2)

    eventually(page, check)
