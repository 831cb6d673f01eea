"""Study of the tip's error in rendered volumes, beside the least possible error."""

import numpy as np
import pytest

from tip_study import End, end_of, study
from tip_study.needle_end import echo_model, samples_near
from tip_study.needles import RADIUS, scanner, sweep_with
from tip_study.runs import noise_db
from tip_study.tables import HEAD, plot

STEEP = End(40, 0.05, "blunt", 20)


def test_the_study_prints_a_line_for_each_kind_of_needle(tmp_path):
    lines = []
    kinds = {"dips": (40,), "depths": (0.05,), "tips": ("blunt",), "contrasts": (20,)}
    rows = study(2, 100, lines.append, bound_volumes=2, **kinds)
    assert [line.count("|") for line in lines] == [HEAD[0].count("|")]
    assert lines[0].startswith("| blunt | 20 dB | 50 mm | 40 deg | 100%")
    plot(rows, tmp_path / "errors.png")
    assert (tmp_path / "errors.png").stat().st_size > 1000


@pytest.mark.slow
@pytest.mark.parametrize("end", [STEEP, End(20, 0.05, "bevel", 20)])
def test_the_model_is_that_of_the_renderer(end):
    """Mean intensities of rendered samples near the axis, in parts of the needle."""
    using, rendered, expected, along = scanner(), [], [], []
    for seed in range(100, 124):
        sweep, ends, _ = sweep_with(end, using, seed)
        k = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        samples = samples_near(using.geometry, using.spread, ends[1] - [0, RADIUS, 0], k)
        model = echo_model(end_of(end, using), samples, np.zeros(1), noise_db(end, using))
        level = sweep.sample(samples.p_P) - using.imaging.tissue_grey
        near = np.linalg.norm(samples.across, axis=1) < 1
        power = np.abs(model.mean[0]) ** 2 + np.sum(np.abs(model.root[0]) ** 2, axis=1)
        rendered.append(10 ** (using.imaging.decibels_per_level * level[near] / 10))
        expected.append(power[near])
        along.append(samples.along[near])
    rendered, expected, along = map(np.concatenate, (rendered, expected, along))
    for start, stop in [(-8, -4), (-4, -1), (-1, 1), (1, 2), (3, 8)]:
        part = (along >= start) & (along < stop)
        difference = 10 * np.log10(rendered[part].mean() / expected[part].mean())
        assert abs(difference) < 2.5, (start, stop)
