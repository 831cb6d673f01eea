"""Movies of a run: the slices with the needle beside curves of the run, as GIF or MP4."""

import io
from collections.abc import Iterable, Iterator, Sequence
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageColor

from sonoservo.systems.evaluation.reports.key_frames import true_needle
from sonoservo.systems.evaluation.reports.plots import (
    BLUE,
    GREEN,
    ORANGE,
    Frame,
    movie_frame,
    title,
)
from sonoservo.systems.evaluation.reports.track_plots import VolumePictures
from sonoservo.systems.evaluation.run_errors import estimate_errors, features
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.writing import write_atomically
from sonoservo.systems.signals.needle_colours import ESTIMATE, TRUTH

FORMATS = (".gif", ".mp4")  # suffixes of movies
_GREYS = 48  # number of greys of a GIF; few colours keep it small
_HUES = (BLUE, ORANGE, GREEN, ESTIMATE, TRUTH)  # colours of a GIF besides the greys


def check_movie(path: Path) -> None:
    """Check that a movie can be written, before anything is simulated."""
    if path.suffix.lower() not in FORMATS:
        raise ConfigurationError(f"{path} must end in {' or '.join(FORMATS)}")
    if path.suffix.lower() == ".mp4" and not (find_spec("imageio") and find_spec("imageio_ffmpeg")):
        raise ConfigurationError(
            f"{path}: MP4 needs the package imageio-ffmpeg: pip install 'imageio[ffmpeg]'; a movie "
            "that ends in .gif needs nothing"
        )


def write_movie(path: Path, frames: Iterable[Frame], rate: float) -> Path:
    """Write (rows, columns, 3) pictures of one size as a movie of `FORMATS`, at a rate in 1/s."""
    check_movie(path)
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise ConfigurationError(f"{path}: the run has no volume to show")
    frames = chain([first], frames)
    if path.suffix.lower() == ".gif":
        pictures = (Image.fromarray(each) for each in frames)
        palette = _palette()
        reduced = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in pictures]
        buffer = io.BytesIO()
        reduced[0].save(buffer, "GIF", save_all=True, append_images=reduced[1:],
                        duration=round(1e3 / rate), loop=0)  # fmt: skip
        return write_atomically(path, buffer.getvalue())
    from imageio import v3

    options = {"plugin": "FFMPEG", "extension": ".mp4", "fps": rate, "macro_block_size": 2}
    return write_atomically(path, v3.imwrite("<bytes>", list(frames), **options))


def _palette() -> Image.Image:
    """Return a picture with the colours of a GIF: greys, and each hue with two of its tints."""
    hues = np.array([ImageColor.getrgb(each) for each in _HUES], dtype=float)
    tints = [255 - share * (255 - hues) for share in (1.0, 0.6, 0.25)]
    greys = np.repeat(np.linspace(0, 255, _GREYS)[:, np.newaxis], 3, axis=1)
    colours = np.concatenate([greys, *tints]).round().astype(np.uint8)
    picture = Image.new("P", (1, 1))
    picture.putpalette(colours.tobytes())
    return picture


def movie_frames(log: RunLog, pictures: Sequence[VolumePictures]) -> Iterator[Frame]:
    """Yield a picture of each volume: its slices with both needles, beside curves of the run."""
    figure = Figure(figsize=(9.6, 5.4))
    inside = {"bottom": 0.09, "top": 0.88, "hspace": 0.45}
    left = figure.add_gridspec(2, 1, left=0.06, right=0.48, **inside)
    right = figure.add_gridspec(3, 1, left=0.55, right=0.98, **inside)
    slices = [figure.add_subplot(left[row]) for row in range(2)]
    servo, tip, force = curves = [figure.add_subplot(right[row]) for row in range(3)]
    x, z, theta = features(log.X_WP, log.needle_tip, log.needle_entry).T
    for axes, time, values, name, colour in (
        (servo, log.time, 1e3 * x, "X, mm", BLUE),
        (servo, log.time, 1e3 * z, "Z, mm", GREEN),
        (servo, log.time, np.degrees(theta), "Theta, deg", ORANGE),
        (tip, log.volume_time, 1e3 * estimate_errors(log).tip, "", BLUE),
        (force, log.time, log.contact_force, "", BLUE),
    ):
        axes.plot(time, values, color=colour, linewidth=1.2, label=name)
    servo.legend(fontsize=7, frameon=False, ncols=3, loc="upper right", handlelength=1)
    for axes, name in zip(curves, ("servo's errors", "tip error, mm", "force, N"), strict=True):
        title(axes, name)
        axes.tick_params(labelsize=7)
        if len(log.time):
            axes.set_xlim(log.time[0], log.time[-1])
    force.set_xlabel("time, s", fontsize=8)
    cursors = [axes.axvline(0, color="0.3", linewidth=1) for axes in curves]
    head = figure.suptitle("", x=0.05, ha="left", fontsize=11)
    for volume, time in enumerate(log.volume_time):
        taken = min(pictures, key=lambda each: abs(each.time - time))
        for axes, picture, view in zip(slices, taken.planes, taken.views, strict=False):
            axes.clear()
            picture.draw(axes, true_needle(log, volume))
            axes.set_title(view, loc="left", fontsize=9)
        for cursor in cursors:
            cursor.set_xdata([time, time])
        head.set_text(f"{time:5.1f} s   {taken.mode}      blue: true needle, orange: estimate")
        yield movie_frame(figure)
