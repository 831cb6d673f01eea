import runpy
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from PIL import Image

GALLERY = Path(__file__).parents[2] / "notebooks" / "gallery.py"


@pytest.mark.slow
def test_gallery_runs_and_its_figures_say_what_they_should(tmp_path, monkeypatch):
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(GALLERY.parent)
    drawn = runpy.run_path(str(GALLERY))
    with Image.open(tmp_path / "gallery.png") as picture:
        assert min(picture.size) > 600
    assert (tmp_path / "gallery.png").stat().st_size < 400e3

    echoes = drawn["figures"]
    steel = echoes["as it is"]
    assert 34 < steel[0].peak_db < 44
    assert steel[-1].peak_db < steel[0].peak_db - 8
    tilts, contrast = drawn["TILTS"], drawn["contrast"]
    across, along = tilts.index(0), tilts.index(75)
    assert np.ptp([levels[across] for levels in contrast.values()]) < 4
    assert contrast["echogenic"][along] > contrast["coated"][along] > 3
    assert contrast["biopsy"][along] < 0
    # The steeper the needle, the further from the middle it faces the beam.
    faces = [echo.distance[np.nanargmax(echo.level_db)] for echo in steel[:4]]
    assert (np.diff(faces) < -3e-3).all()
    # What echoes within the needle comes later and makes it look thicker.
    assert steel[0].thickness > 2 * echoes["no reverberation"][0].thickness
    assert all(
        dimpled.visible_length >= smooth.visible_length
        for dimpled, smooth in zip(echoes["dimpled, in tissue"], echoes["in tissue"], strict=True)
    )


@pytest.mark.slow
def test_every_dial_is_drawn_at_three_strengths(tmp_path, monkeypatch):
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(GALLERY.parent)
    drawn = runpy.run_path(str(GALLERY.with_name("gallery_of_dials.py")))
    assert all(len(shown) == 3 for shown in drawn["ROWS"].values())
    with Image.open(tmp_path / "gallery_of_dials.png") as picture:
        assert min(picture.size) > 600


@pytest.mark.slow
def test_moving_picture_shows_the_run(tmp_path):
    drawn = runpy.run_path(str(GALLERY.with_name("moving_picture.py")))
    drawn["main"](tmp_path / "needle.webp")
    with Image.open(tmp_path / "needle.webp") as picture:
        assert picture.n_frames >= 2
    assert (GALLERY.parent / "needle.webp").stat().st_size < 3e6
