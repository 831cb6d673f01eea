import numpy as np
import pytest
from PIL import Image

from sonoservo.systems.evaluation.reports.movie import check_movie, write_movie
from sonoservo.systems.files.refusals import ConfigurationError

ORANGE = (230, 159, 0)


def frames(count):
    for number in range(count):
        picture = np.full((40, 60, 3), 5 * number, np.uint8)
        picture[:10, 10 * number : 10 * number + 5] = ORANGE
        yield picture


def test_gif_keeps_its_frames_its_pace_and_rare_colours(tmp_path):
    path = write_movie(tmp_path / "a.gif", frames(4), 5.0)
    with Image.open(path) as movie:
        assert (movie.n_frames, movie.size, movie.info["duration"]) == (4, (60, 40), 200)
        movie.seek(3)
        assert np.allclose(movie.convert("RGB").getpixel((32, 5)), ORANGE, atol=2)
        assert np.allclose(movie.convert("RGB").getpixel((5, 30)), 15, atol=5)


def test_mp4_is_written_by_its_package(tmp_path):
    v3 = pytest.importorskip("imageio.v3")
    pytest.importorskip("imageio_ffmpeg")
    path = write_movie(tmp_path / "a.mp4", frames(4), 5.0)
    assert v3.imread(path).shape == (4, 40, 60, 3)


def test_what_cannot_be_written_is_refused_beforehand(tmp_path, monkeypatch):
    with pytest.raises(ConfigurationError, match=r"a\.avi must end in \.gif or \.mp4"):
        check_movie(tmp_path / "a.avi")
    with pytest.raises(ConfigurationError, match="no volume to show"):
        write_movie(tmp_path / "a.gif", [], 5.0)
    monkeypatch.setattr("sonoservo.systems.evaluation.reports.movie.find_spec", lambda name: None)
    with pytest.raises(ConfigurationError, match=r"pip install 'imageio\[ffmpeg\]'"):
        check_movie(tmp_path / "a.mp4")
