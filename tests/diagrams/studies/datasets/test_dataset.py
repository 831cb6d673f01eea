"""Labelled sequences: labels lie where the image shows the needle, and nothing is made twice."""

import hashlib
import io
import json

import h5py
import numpy as np
import pytest
import SimpleITK
from pydrake.math import RigidTransform

from sonoservo.diagrams import load_scenario
from sonoservo.diagrams.studies import Store, make_dataset
from sonoservo.diagrams.studies.datasets.dataset_sequence import needle_mask, write_layout
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.recording import Recording
from sonoservo.systems.signals import Needle, Volume


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("dataset")
    # A needle that shows at every angle tells where it is.
    rough = {"scanner.needle.diffuse_db": -20.0, "scanner.needle.diffuse_lobe_deg": None}
    scenario = load_scenario("chatelain2013_fig5", changes=rough, seed=100)
    return out, scenario, make_dataset(scenario, out, count=2, volumes=2, jobs=1)


def test_the_manifest_names_every_file_with_its_checksum(made):
    out, _, manifest = made
    assert not manifest["failed"]
    assert manifest == json.loads((out / "manifest.json").read_text())
    assert [each["seed"] for each in manifest["sequences"]] == [100, 101]
    assert "within one grey level in 99.9 %" in manifest["reproducible"]
    for sequence in manifest["sequences"]:
        folder = out / sequence["name"]
        names = {path.name for path in folder.iterdir()}
        assert {"volumes.seq.nrrd", "mask_001.seg.nrrd", "labels.json"} <= names
        assert {f"{folder.name}/{name}" for name in names} == set(sequence["files"])
        assert sequence["processor"]
        for name, file in sequence["files"].items():
            assert hashlib.sha256((out / name).read_bytes()).hexdigest() == file["sha256"]


def test_labels_lie_where_the_image_is_bright(made):
    out, _, manifest = made
    drawn = []
    for sequence in manifest["sequences"]:
        folder = out / sequence["name"]
        labels = json.loads((folder / "labels.json").read_text())
        drawn.append((labels["imaging"]["gain"], labels["tissue"]["seed"], labels["hand"]["entry"]))
        for number, volume in enumerate(Recording(folder / "volumes.seq.nrrd")):
            image = SimpleITK.ReadImage(str(folder / f"mask_{number:03d}.seg.nrrd"))
            mask = SimpleITK.GetArrayFromImage(image).T.astype(bool)
            assert mask.shape == volume.intensities.shape
            seen = volume.intensities[volume.intensities > 0]
            # The needle's echo comes from its front wall: the brightest voxel within 1 mm counts.
            assert np.median(volume.intensities[mask]) > np.quantile(seen, 0.9)
            label = labels["volumes"][number]
            assert label["time_s"] == volume.time
            shaft = np.array(label["needle_lps_mm"])
            np.testing.assert_array_equal(shaft[-1], label["tip_lps_mm"])
            tip = image.TransformPhysicalPointToIndex(label["tip_lps_mm"])
            around = tuple(slice(max(i - 1, 0), i + 2) for i in tip)
            assert mask[around].any()
            beyond = shaft[-1] + 4 * (shaft[-1] - shaft[-2]) / np.linalg.norm(shaft[-1] - shaft[-2])
            assert not mask[image.TransformPhysicalPointToIndex(beyond.tolist())]
    assert len(set(map(str, drawn))) == len(drawn)


def test_only_what_is_missing_is_made_again_and_comes_out_the_same(made):
    out, scenario, manifest = made
    volumes = [out / each["name"] / "volumes.seq.nrrd" for each in manifest["sequences"]]
    volumes[1].write_bytes(b"damaged")
    kept = volumes[0].stat().st_mtime_ns
    again = make_dataset(scenario, out, count=2, volumes=2, jobs=1)
    assert volumes[0].stat().st_mtime_ns == kept
    assert again == manifest


def test_calls_with_one_store_are_merged_in_its_manifest(tmp_path):
    """In nnU-Net's layout and in memory, with every dial drawn."""
    store, made = f"memory://{tmp_path.name}", []
    for seed in (101, 100, 101):
        scenario = load_scenario("chatelain2013_fig5", seed=seed, changes=["imaging.sector=0.5"])
        made.append(
            make_dataset(
                scenario, tmp_path / str(len(made)), count=1, volumes=1 + (seed == 100), jobs=1,
                randomize=True, layout="nnunet", store=store,
            )
        )  # fmt: skip
    assert [each["seed"] for each in made[1]["sequences"]] == [100, 101]
    assert made[2] == made[1]
    place = Store(store)
    listed = {name for each in made[2]["sequences"] for name in each["files"]}
    assert listed < place.sizes().keys()
    assert json.loads(place.read("manifest.json")) == made[2]
    dataset, splits = (json.loads(place.read(f"{n}.json")) for n in ("dataset", "splits_final"))
    assert dataset["numTraining"] == 3
    assert dataset["labels"] == {"background": 0, "needle": 1}
    names = {"sequence_00100_000", "sequence_00100_001", "sequence_00101_000"}
    for split in splits:
        assert set(split["train"]) | set(split["val"]) == names
        assert not {n[:14] for n in split["train"]} & {n[:14] for n in split["val"]}
    for name in names:
        images = []
        for path in (f"imagesTr/{name}_0000.nrrd", f"labelsTr/{name}.nrrd"):
            (tmp_path / "one.nrrd").write_bytes(place.read(path))
            images.append(SimpleITK.ReadImage(str(tmp_path / "one.nrrd")))
        for attribute in ("GetSize", "GetSpacing", "GetOrigin", "GetDirection"):
            assert len({getattr(image, attribute)() for image in images}) == 1
        assert set(np.unique(SimpleITK.GetArrayFromImage(images[1]))) == {0, 1}
    drawn = [json.loads(place.read(f"labels/sequence_00{n}.json"))["dials"] for n in (100, 101)]
    assert drawn[0] != drawn[1]
    assert all(drawn)


def test_files_of_zea_hold_volumes_and_masks_and_repeat_bit_for_bit(tmp_path):
    grey = np.random.default_rng(0).integers(1, 255, (6, 5, 4)).astype(np.uint8)
    volumes = [Volume(grey, [0, 0, 0], [1e-3] * 3, RigidTransform(), 0.3 * k) for k in range(2)]
    labelled = [(volume, grey > 200) for volume in volumes]
    files, again = (write_layout("zea", "s", labelled, lambda: {"a": 1}) for _ in range(2))
    assert files == again
    assert sorted(files) == ["s/labels.json", "s/volumes.hdf5"]
    with h5py.File(io.BytesIO(files["s/volumes.hdf5"])) as file:
        np.testing.assert_array_equal(file["data/image_sc/pixels"][1], grey)
        np.testing.assert_array_equal(file["data/segmentation/pixels"][0, ..., 0], grey > 200)


def test_a_damaged_manifest_is_left_alone(tmp_path):
    scenario = load_scenario("chatelain2013_fig5", seed=100)
    (tmp_path / "manifest.json").write_text('{"format": 1}')
    with pytest.raises(ConfigurationError, match="manifest.json: cannot be merged with"):
        make_dataset(scenario, tmp_path, count=1)
    assert (tmp_path / "manifest.json").read_text() == '{"format": 1}'


def test_a_mask_is_the_needle_s_tube():
    volume = Volume(np.ones((40, 30, 20), np.uint8), [0, 0, 0], [1e-3] * 3, RigidTransform(), 0.0)
    shaft = np.array([[-5e-3, 15e-3, 10e-3], [20e-3, 15e-3, 10e-3], [20e-3, 15e-3, 15e-3]])
    mask = needle_mask(volume, Needle(shaft, 1.2e-3))
    wanted = np.zeros_like(mask)
    wanted[:21, 14:17, 10] = wanted[:21, 15, 9:12] = True
    wanted[19:22, 15, 10:16] = wanted[20, 14:17, 10:16] = True
    wanted[21, 15, 10] = wanted[20, 15, 16] = True
    np.testing.assert_array_equal(mask, wanted)
    assert not needle_mask(volume, Needle(np.zeros((0, 3)), 1e-3)).any()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"count": 10**30}, "count: 10+ is not allowed"),
        ({"transducers": ["4dc8"]}, "4dc8"),
        ({"layout": "nnUNet"}, "did you mean 'nnunet'"),
        ({"store": "nowhere://needles"}, "store: nowhere://needles: Protocol not known"),
    ],
)
def test_what_cannot_be_made_is_refused(tmp_path, changes, message):
    scenario = load_scenario("chatelain2013_fig5", seed=100)
    with pytest.raises(ConfigurationError, match=message):
        make_dataset(scenario, tmp_path, **{"count": 1} | changes)
    assert not list(tmp_path.iterdir())
