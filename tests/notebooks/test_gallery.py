import runpy
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from PIL import Image

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gallery", "gallery_of_dials"])
def test_galleries_run_and_their_figures_say_what_they_should(name, tmp_path, monkeypatch):
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(NOTEBOOKS)
    drawn = runpy.run_path(str(NOTEBOOKS / f"{name}.py"))
    with Image.open(f"{name}.png") as picture:
        assert min(picture.size) > 600
    if name == "gallery_of_dials":
        assert all(len(shown) == 3 for shown in drawn["ROWS"].values())
        return
    assert Path("gallery.png").stat().st_size < 400e3
    steel = drawn["figures"]["as it is"]
    assert 34 < steel[0].peak_db < 44
    # The steeper the needle, the further from the middle it faces the beam.
    faces = [echo.distance[np.nanargmax(echo.level_db)] for echo in steel[:4]]
    assert (np.diff(faces) < -3e-3).all()


@pytest.mark.slow
def test_moving_picture_shows_the_run(tmp_path):
    drawn = runpy.run_path(str(NOTEBOOKS / "moving_picture.py"))
    drawn["main"](tmp_path / "needle.webp")
    with Image.open(tmp_path / "needle.webp") as picture:
        assert picture.n_frames >= 2
    assert (NOTEBOOKS / "needle.webp").stat().st_size < 3e6
