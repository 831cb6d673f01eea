"""Label maps: files, errors, cubes in T, surfaces, and what they look like."""

from dataclasses import replace

import nibabel
import nrrd
import numpy as np
import pytest
import yaml
from renderers import DOWN, make_renderer, shift, still

from sonoservo.systems.ultrasound.simulation import AnatomyParameters, load_tissue
from sonoservo.systems.ultrasound.simulation.anatomy.anatomies import LiverAnatomy, liver_label_map
from sonoservo.systems.ultrasound.simulation.anatomy.anatomy_grid import (
    LabelProperties,
    anatomy_grid,
)
from sonoservo.systems.ultrasound.simulation.anatomy.label_map import (
    LabelMap,
    read_label_map,
    write_label_map,
)

SHAPE = (40, 30, 20)


def ball_map(X_LV=None, radius=8e-3):
    """A ball of label 7 in the middle, voxels of 1 mm unless stated."""
    if X_LV is None:
        X_LV = np.diag([1e-3, 1e-3, 1e-3, 1.0])
    indices = np.stack(np.indices(SHAPE), axis=-1)
    points = indices @ X_LV[:3, :3].T
    middle = (np.array(SHAPE) - 1) / 2 @ X_LV[:3, :3].T
    inside = np.linalg.norm(points - middle, axis=-1) < radius
    return LabelMap(np.where(inside, 7, 0).astype(np.uint16), X_LV)


def oblique(spacing=(1e-3, 1.5e-3, 2e-3)):
    X = np.eye(4)
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    X[:3, :3] = turn * spacing
    X[:3, 3] = [0.1, -0.05, 0.02]
    return X


def table(**changes):
    return AnatomyParameters(labels=[LabelProperties(label=7, **changes)])


def test_nrrd_round_trip(tmp_path):
    written = ball_map(oblique())
    read = read_label_map(write_label_map(tmp_path / "map.nrrd", written))
    np.testing.assert_array_equal(read.labels, written.labels)
    np.testing.assert_allclose(read.X_LV, written.X_LV, atol=1e-9)


def test_nifti_speaks_of_the_right_and_the_front(tmp_path):
    written = ball_map(oblique())
    to_ras = np.diag([-1e3, -1e3, 1e3, 1]) @ written.X_LV
    nibabel.save(
        nibabel.Nifti1Image(written.labels.astype(np.int16), to_ras), tmp_path / "m.nii.gz"
    )
    read = read_label_map(tmp_path / "m.nii.gz")
    np.testing.assert_array_equal(read.labels, written.labels)
    np.testing.assert_allclose(read.X_LV, written.X_LV, atol=1e-6)


def test_nifti_without_a_pose_lies_as_itk_has_it(tmp_path):
    image = nibabel.Nifti1Image(ball_map().labels[..., np.newaxis, np.newaxis], None)
    image.header.set_zooms((1, 2, 3, 1, 1))
    nibabel.save(image, tmp_path / "m.nii")
    read = read_label_map(tmp_path / "m.nii")
    np.testing.assert_array_equal(read.labels, ball_map().labels)
    np.testing.assert_allclose(read.X_LV, np.diag([1e-3, 2e-3, 3e-3, 1]))


def test_ras_nrrd_is_turned(tmp_path):
    header = lps([1.0, 2, 3]) | {"space": "RAS", "space origin": [1.0, 2, 3]}
    nrrd.write(str(tmp_path / "m.nrrd"), np.zeros(SHAPE, np.uint8), header)
    X = read_label_map(tmp_path / "m.nrrd").X_LV
    np.testing.assert_allclose(X[:3, :3], np.diag([-1e-3, -2e-3, 3e-3]))
    np.testing.assert_allclose(X[:3, 3], [-1e-3, -2e-3, 3e-3])


def lps(axes=1.0):
    return {"space": "LPS", "space directions": np.diag(np.broadcast_to(axes, 3))}


FLAT = lps() | {"space directions": [[1.0, 0, 0], [1, 0, 0], [0, 0, 1]]}


@pytest.mark.parametrize(
    ("data", "header", "message"),
    [
        (np.zeros((3, 4, 4, 4), np.uint8), {}, "a single label map"),
        (np.zeros(SHAPE, np.uint8), {}, "space directions.*three vectors"),
        (np.zeros(SHAPE, np.uint8), FLAT, "axes.*three independent directions"),
        (np.zeros(SHAPE, np.uint8), lps(700.0), "voxel size.*from 0.01 to 20 mm"),
        (np.zeros(SHAPE, np.uint8), lps() | {"space": "scanner-xyz"}, "space.*is not allowed"),
        (np.full(SHAPE, np.nan, np.float32), lps(), "labels: 'NaN or infinity'"),
        (np.full(SHAPE, 0.5, np.float32), lps(), "labels: 'fractions'"),
        (np.full(SHAPE, -1, np.int16), lps(), "labels.*from 0 to 65535"),
    ],
)
def test_bad_map_gives_one_clear_line(tmp_path, data, header, message):
    nrrd.write(str(tmp_path / "bad.nrrd"), data, header)
    with pytest.raises(ValueError, match=message) as caught:
        read_label_map(tmp_path / "bad.nrrd")
    assert "\n" not in str(caught.value)
    assert "bad.nrrd" in str(caught.value)


def test_unknown_label_is_named():
    with pytest.raises(ValueError, match=r"labels: \[7\].*table of labels, which has 0"):
        anatomy_grid(ball_map(), AnatomyParameters())


@pytest.mark.parametrize("X_LV", [None, oblique()], ids=["straight", "oblique"])
def test_ball_keeps_its_volume_and_its_middle(X_LV):
    radius = 9e-3
    grid = anatomy_grid(ball_map(X_LV, radius), table(boundary_db=20))
    inside = grid.numbers == 1
    volume = inside.sum() * grid.spacing**3
    assert volume == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.09)
    middle = np.argwhere(inside).mean(axis=0) * grid.spacing + grid.origin + grid.spacing / 2
    assert middle == pytest.approx([0, 0, -grid.size[2] / 2], abs=1e-3)
    surface, _ = grid.surfaces[0]
    assert surface.areas.sum() == pytest.approx(4 * np.pi * radius**2, rel=0.08)
    outward = surface.points - middle
    along = np.einsum("ij,ij->i", outward, surface.normals) / np.linalg.norm(outward, axis=1)
    assert np.average(along, weights=surface.areas) > 0.97


@pytest.mark.parametrize(("top", "corner"), [("A", [0, 0, 0]), ("S", [0, 0, 1])])
def test_side_towards_the_probe(top, corner):
    labels = np.zeros((20, 30, 40), np.uint16)
    end = [size // 2 for size in labels.shape]
    axis = {"A": 1, "S": 2}[top]
    end[axis] = labels.shape[axis] - 2 if corner[axis] else 2
    labels[end[0] - 2 : end[0] + 2, end[1] - 1 : end[1] + 2, end[2] - 1 : end[2] + 2] = 7
    label_map = LabelMap(labels, np.diag([1e-3, 1e-3, 1e-3, 1]))
    grid = anatomy_grid(label_map, replace(table(), top=top))
    height = np.argwhere(grid.numbers == 1)[:, 2].mean() / grid.numbers.shape[2]
    assert height > 0.85


def render(tissue, x=0.0):
    renderer = make_renderer(tissue, sector=0.4, frames=9, volume_rate=3, focus_depth=0.025)
    return renderer, renderer.tissue_echo(still(renderer, shift(x, 0, 0.1) @ DOWN), 1)


def labelled(tmp_path, **changes):
    """A block 100 mm wide and deep of label 1, as a phantom of its own file."""
    labels = np.ones((100, 100, 80), np.uint16)
    write_label_map(tmp_path / "block.nrrd", LabelMap(labels, np.diag([1e-3] * 3 + [1])))
    anatomy = {"labels": [{"label": 1, **changes}]}
    (tmp_path / "block.yaml").write_text(yaml.safe_dump({"tissue": {"anatomy": anatomy}}))
    return load_tissue(str(tmp_path / "block.nrrd"))


def test_label_has_its_level_and_its_speckle(tmp_path):
    """<I^2> / <I>^2 = 2 + 1/N, N = 4 x density: a K distribution with nu = 2 N."""
    moments, levels = [], []
    for seed in range(3):
        tissue = replace(labelled(tmp_path, level_db=-8.0, density=0.25), seed=seed)
        assert tissue.size == pytest.approx([0.0996, 0.0798, 0.0996], abs=1e-3)
        renderer, echo = render(tissue)
        _, plain = render(replace(tissue, anatomy=None))
        part = slice(int(0.03 / renderer.geometry.sample_pitch), -20)
        intensity = np.abs(echo[:, 8:-8, part]).astype(float) ** 2
        levels.append(intensity.mean() / (np.abs(plain[:, 8:-8, part]) ** 2).mean())
        moments.append((intensity**2).mean() / intensity.mean() ** 2)
    assert 10 * np.log10(np.mean(levels)) == pytest.approx(-8, abs=0.4)
    assert np.mean(moments) == pytest.approx(3, abs=0.35)


def test_label_attenuates(tmp_path):
    """2 x 0.4 dB/(cm MHz) more than tissue, 3.3 MHz: 2.64 dB for each cm."""
    tissue = labelled(tmp_path, attenuation=0.9)
    renderer, echo = render(tissue)
    _, plain = render(replace(tissue, anatomy=None))
    pitch = renderer.geometry.sample_pitch
    ratio = [
        20 * np.log10(np.linalg.norm(echo[..., part]) / np.linalg.norm(plain[..., part]))
        for part in (slice(int(d / pitch), int((d + 0.01) / pitch)) for d in (0.02, 0.07))
    ]
    assert ratio[1] - ratio[0] == pytest.approx(-2.64 * 5, abs=0.7)


def test_label_map_needs_a_table_beside_it(tmp_path):
    write_label_map(tmp_path / "mine.nrrd", ball_map())
    with pytest.raises(FileNotFoundError, match=r"needs a file mine.yaml beside it"):
        load_tissue(str(tmp_path / "mine.nrrd"))
    with pytest.raises(FileNotFoundError, match="no file"):
        load_tissue(str(tmp_path / "other.nii.gz"))


def test_liver_has_veins_a_gallbladder_and_a_rib():
    label_map = liver_label_map(3)
    assert set(np.unique(label_map.labels)) == {0, 1, 2, 3, 4, 5}
    assert 0.01 < (label_map.labels == 2).mean() < 0.15
    tissue = load_tissue("liver")
    assert tissue.size == pytest.approx([0.16, 0.12, 0.08], abs=1e-3)
    assert isinstance(tissue.anatomy, LiverAnatomy)
    renderer, echo = render(tissue, x=0.045)
    line = 20 * np.log10(np.abs(echo[4, 20:30]).mean(axis=0) + 1e-6)
    pitch = renderer.geometry.sample_pitch
    assert line[int(0.047 / pitch) : int(0.053 / pitch)].max() < -20  # gallbladder
    assert line[int(0.064 / pitch) : int(0.07 / pitch)].mean() > 0.5  # enhancement behind it
