"""What a page of Meshcat shows, and where."""

import io
import time

import numpy as np
from PIL import Image

_PROJECT = """
points => {
  const scene = viewer.scene_tree.object;
  scene.updateMatrixWorld(true);
  viewer.camera.updateMatrixWorld();
  const canvas = viewer.renderer.domElement.getBoundingClientRect();
  return points.map(point => {
    const v = viewer.camera.position.clone().set(...point);
    scene.localToWorld(v).project(viewer.camera);
    return [canvas.x + (v.x + 1) / 2 * canvas.width, canvas.y + (1 - v.y) / 2 * canvas.height];
  });
}
"""


def project(page, points):
    """(n, 2) pixels, column and row, at which (n, 3) points of the scene appear."""
    return np.array(page.evaluate(_PROJECT, np.reshape(points, (-1, 3)).tolist()))


def screenshot(page):
    """(rows, columns, 3) colours of the page."""
    with Image.open(io.BytesIO(page.screenshot())) as image:
        return np.array(image.convert("RGB"))


def wait_for_object(page, path):
    """Wait until an object is in the scene: ``/drake/sector``."""
    names = [name for name in path.split("/") if name]
    page.wait_for_function(
        "names => names.reduce((node, name) => node && node.children[name], viewer.scene_tree)",
        arg=names,
    )


def eventually(page, check, patience=60.0):
    """Return what a check returns once it holds; how soon depends on the machine alone."""
    end = time.monotonic() + patience
    while True:
        try:
            return check()
        except AssertionError:
            if time.monotonic() > end:
                raise
        page.wait_for_timeout(100)
