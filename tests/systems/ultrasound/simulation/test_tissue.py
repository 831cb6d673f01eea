from dataclasses import replace

import numpy as np
import pytest
from renderers import DEEP, make_renderer, still

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.ultrasound.simulation import Ball, Tissue, load_tissue
from sonoservo.systems.ultrasound.simulation.kernels.blocks import scatterer_tile
from sonoservo.systems.ultrasound.simulation.tissue import Fibre, RandomBalls, RandomFibres


def test_blocks_of_a_tile_have_the_scatterers_of_a_poisson_process():
    tile = scatterer_tile(2.5e9, np.random.default_rng(1))
    counts = np.diff(tile.starts)
    assert counts.mean() == pytest.approx(2.5e9 * tile.block_size**3, rel=0.02)
    assert counts.var() == pytest.approx(counts.mean(), rel=0.25)


def test_random_balls_have_the_stated_density_radii_and_levels():
    random = RandomBalls(per_cubic_centimetre=0.5, smallest=1e-3, largest=2e-3, dimmest_db=20)
    size = [0.2, 0.1, 0.1]
    balls = random.draw(size, np.random.default_rng(0))
    assert len(balls) == pytest.approx(1000, rel=0.1)
    centres = np.array([ball.centre for ball in balls])
    assert (np.abs(np.add(centres, [0, 0, 0.05])) <= np.array(size) / 2).all()
    assert centres.std(axis=0) == pytest.approx(np.array(size) / np.sqrt(12), rel=0.1)
    for name, low, high in (("radius", 1e-3, 2e-3), ("level_db", 20, 30)):
        values = [getattr(ball, name) for ball in balls]
        assert low <= min(values) < max(values) <= high
    assert Tissue().random_balls.draw(size, np.random.default_rng(0)) == []


def test_the_level_of_a_tissue_is_that_of_its_echoes():
    for level in (0.0, -12.0):
        renderer = make_renderer(replace(DEEP, level_db=level), sector=0.4, frames=9)
        power = np.abs(renderer.tissue_echo(still(renderer), 1)) ** 2
        assert 10 * np.log10(power.mean()) == pytest.approx(level, abs=0.6)


def test_random_fibres_have_the_stated_density_lengths_levels_and_direction():
    fibres = RandomFibres(
        per_cubic_centimetre=0.5, shortest=3e-3, longest=9e-3, dimmest_db=15.0,
        brightest_db=30.0, direction=[0.0, 2.0, 0.0], spread_deg=10.0,
    )  # fmt: skip
    size = np.array([0.2, 0.1, 0.1])
    drawn = fibres.draw(size.tolist(), np.random.default_rng(3))
    assert len(drawn) == pytest.approx(1000, rel=0.1)
    start, end = (np.array([getattr(f, name) for f in drawn]) for name in ("start", "end"))
    lengths = np.linalg.norm(end - start, axis=1)
    assert lengths.min() >= 3e-3
    assert lengths.max() <= 9e-3
    assert lengths.mean() == pytest.approx(6e-3, rel=0.05)
    middles = 0.5 * (start + end)
    assert (np.abs(middles[:, :2]) <= size[:2] / 2).all()
    assert (middles[:, 2] <= 0).all()
    assert (middles[:, 2] >= -0.1).all()
    aside = np.arcsin(((end - start) / lengths[:, np.newaxis])[:, [0, 2]])
    assert np.rad2deg(aside.std()) == pytest.approx(10, rel=0.1)
    levels = [fibre.level_db for fibre in drawn]
    assert 15 <= min(levels) < 16
    assert 29 < max(levels) <= 30


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Tissue(size=[240, 160, 80]), r"^size: .* in m"),
        (lambda: Tissue(balls=[Ball(), Ball(centre=[0, 0, 0.04])]), r"^balls\[1\].*z from its top"),
        (lambda: Tissue(fibres=[Fibre(end=[10.0, 0, -40])]), r"^fibres\[0\]\.end: "),
        (lambda: Fibre(start=[0, 0, 0], end=[0, 0, 0]), "end"),
        (lambda: RandomBalls(largest=0.5e-3), "largest"),
        (lambda: RandomFibres(longest=1e-3), "longest"),
        (lambda: RandomFibres(brightest_db=0.0), "brightest_db"),
        (lambda: RandomFibres(direction=[0.0, 0.0, 0.0]), "direction"),
    ],
)
def test_errors_name_the_field(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_errors_of_a_file_name_the_place(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("tissue: {balls: [{radius: -1}]}\n")
    with pytest.raises(ConfigurationError, match=r"balls\.0"):
        load_tissue(str(path))
