from dataclasses import replace

import numpy as np
import pytest
from renderers import DEEP, make_renderer, still

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.ultrasound.simulation.kernels.blocks import BLOCKS
from sonoservo.systems.ultrasound.simulation.kernels.blocks import (
    scatterer_tile as make_tile,
)
from sonoservo.systems.ultrasound.simulation.tissue import (
    Ball,
    Fibre,
    RandomBalls,
    RandomFibres,
    Tissue,
    load_tissue,
)


def test_tile_is_a_uniform_poisson_process():
    density = 2.5e9
    tile = make_tile(density, np.random.default_rng(1))
    expected = density * tile.block_size**3
    counts = np.diff(tile.starts)
    assert len(counts) == BLOCKS**3
    assert counts.mean() == pytest.approx(expected, rel=0.02)
    assert counts.var() == pytest.approx(expected, rel=0.25)
    for axis in tile.positions:
        assert axis.min() >= 0
        assert axis.max() <= tile.block_size
        assert axis.mean() == pytest.approx(tile.block_size / 2, rel=0.01)


def test_ranks_rise_within_a_block_and_are_uniform():
    tile = make_tile(2.5e9, np.random.default_rng(1))
    for start, end in zip(tile.starts[:20], tile.starts[1:21], strict=True):
        assert (np.diff(tile.ranks[start:end]) >= 0).all()
    share, _ = np.histogram(tile.ranks, 10, (0, 1))
    assert share == pytest.approx(len(tile.ranks) / 10, rel=0.05)


def test_agar_is_dark_and_has_bright_things_anywhere_also_in_a_needles_way():
    """The way of `chatelain2013_fig5`: from 42 mm below the top, dipping by 5 deg, +-10 mm."""
    agar = load_tissue("agar")
    assert agar.size == Tissue().size
    assert agar.level_db < -6
    assert agar.scatterers_per_cell <= 1
    near = []
    for seed in range(100, 140):
        balls = agar.random_balls.draw(agar.size, np.random.default_rng([seed, 5]))
        x, y, z = np.array([ball.centre for ball in balls]).T
        level = -0.042 - (x + 0.12) * np.tan(np.deg2rad(5))
        aside = np.hypot(np.maximum(np.abs(y) - 0.01, 0), z - level)
        near.append(np.sum((x > -0.12) & (x < 0) & (aside < 4e-3)))
    # As many as lie in a slab 0.12 m x 20 mm x 8 mm with rounded edges.
    volume = 120 * (20 * 8 + np.pi * 16) / 1e3
    assert np.mean(near) == pytest.approx(agar.random_balls.per_cubic_centimetre * volume, rel=0.4)
    assert max(near) > min(near) == 0


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
    with pytest.raises(ValueError, match="largest"):
        RandomBalls(largest=0.5e-3)


def test_the_level_of_a_tissue_is_that_of_its_echoes():
    for level in (0.0, -12.0):
        renderer = make_renderer(replace(DEEP, level_db=level), sector=0.4)
        power = np.abs(renderer.tissue_echo(still(renderer), 1)) ** 2
        assert 10 * np.log10(power.mean()) == pytest.approx(level, abs=0.6)


def test_errors_name_the_field(tmp_path):
    with pytest.raises(ValueError, match="scatterers_per_cell"):
        Tissue(scatterers_per_cell=0)
    with pytest.raises(ValueError, match="^scatterers_per_cell: -4"):
        Tissue(scatterers_per_cell=-4)
    with pytest.raises(ValueError, match="size"):
        Tissue(size=[0.1, 0.1])
    with pytest.raises(ValueError, match=r"^size: .* in m"):
        Tissue(size=[240, 160, 80])
    with pytest.raises(ValueError, match=r"^balls\[1\]\.centre: .* z from its top"):
        Tissue(balls=[Ball(), Ball(centre=[0, 0, 0.04])])
    with pytest.raises(ValueError, match=r"^fibres\[0\]\.end: "):
        Tissue(fibres=[Fibre(end=[10.0, 0, -40])])
    with pytest.raises(ValueError, match="end"):
        Fibre(start=[0, 0, 0], end=[0, 0, 0])
    with pytest.raises(ValueError, match="radius"):
        Ball(radius=0)
    path = tmp_path / "mine.yaml"
    path.write_text("tissue: {balls: [{radius: -1}]}\n")
    with pytest.raises(ConfigurationError, match=r"balls\.0"):
        load_tissue(str(path))


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
    ("changes", "message"),
    [
        ({"per_cubic_centimetre": -1.0}, "per_cubic_centimetre"),
        ({"longest": 1e-3}, "longest"),
        ({"brightest_db": 0.0}, "brightest_db"),
        ({"direction": [0.0, 0.0, 0.0]}, "direction"),
    ],
)
def test_bad_random_fibres_are_named(changes, message):
    with pytest.raises(ValueError, match=message):
        RandomFibres(**changes)
