"""Files of other software, and what is wrong with some of them."""

import gzip
import tracemalloc

import nrrd
import numpy as np
import pytest
from recordings import tracked, write_meta_image, write_sequence_nrrd

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.recording import Recording

SHAPE = (6, 8, 5)
RNG = np.random.default_rng(0)
ARRAYS = [RNG.integers(1, 256, SHAPE).astype(np.uint8) for _ in range(4)]


def place(volume, index):
    """Where in W, in mm, a volume has its voxel."""
    return 1e3 * volume.to_world(volume.position([index]))[0][0]


@pytest.mark.parametrize(
    ("array", "window", "wanted"),
    [
        (ARRAYS[0].astype(np.float32), None, ARRAYS[0]),
        (ARRAYS[0].astype(">i2"), None, ARRAYS[0]),
        (ARRAYS[0].astype(np.float64) * 40 - 1000, (-1000, 9200), ARRAYS[0]),
        (ARRAYS[0], (100, 200), np.clip((ARRAYS[0] - 100.0) * 2.55, 0, 255)),
    ],
)
def test_numbers_become_grey_levels(tmp_path, array, window, wanted):
    path = write_sequence_nrrd(tmp_path / "a.seq.nrrd", [array], times=[0.0])
    (volume,) = recording = Recording(path, window=window)
    assert repr(recording) == f"Recording({str(path)!r}, 1 volume, 0.0 s)"
    np.testing.assert_allclose(volume.intensities, wanted, atol=1e-4)


def test_numbers_for_nothing_were_not_seen(tmp_path):
    outside = np.indices(SHAPE)[0] == 0
    for name, marker, dtype, options in (
        ("lowest", -32768, np.int16, {}),
        ("highest", 65535, np.uint16, {}),
        ("nan", np.nan, np.float32, {}),
        ("huge", -3e38, np.float32, {}),
        ("stated", 0, np.uint8, {"void": 0.0}),
    ):
        array = np.where(outside, dtype(marker), ARRAYS[0].astype(dtype))
        path = write_sequence_nrrd(tmp_path / f"{name}.seq.nrrd", [array], times=[0.0])
        (volume,) = Recording(path, **options)
        np.testing.assert_array_equal(volume.seen, ~outside)
        assert not volume.intensities[outside].any()
        np.testing.assert_allclose(volume.intensities[~outside], ARRAYS[0][~outside], atol=2)
    # What is black around the field of view was not seen either.
    sector = np.where(np.indices(SHAPE)[0] < SHAPE[0] // 2, 0, ARRAYS[0]).astype(np.float32)
    sector[-1] = np.nan
    (volume,) = Recording(write_sequence_nrrd(tmp_path / "b.seq.nrrd", [sector], times=[0.0]))
    assert not volume.seen[: SHAPE[0] // 2].any()
    assert not volume.seen[-1].any()
    # Neither dark speckle nor a type's own darkest number is a marker.
    dark = Recording(write_sequence_nrrd(tmp_path / "a.seq.nrrd", [ARRAYS[0].astype("i2") - 128]))
    assert dark[0].mask is None


def test_tracked_volumes_of_plus_have_poses_and_invalid_ones_are_skipped(tmp_path):
    path = write_meta_image(tmp_path / "a.mha", ARRAYS, tracked(4, invalid=[1]))
    recording = Recording(path)
    assert recording.posed
    assert (len(recording), recording.skipped) == (3, 1)
    assert recording.left_out == {"marked as invalid": [1]}
    np.testing.assert_allclose(recording.stated_times, [10, 10.25, 10.5, 10.75])
    assert "for 1 volume a second" in " ".join(Recording(path, volume_rate=1).notes)
    untimed = Recording(path, poses="none", timed=False)
    np.testing.assert_allclose(untimed.times, range(4))
    assert not untimed.notes
    np.testing.assert_allclose(recording.times, [10, 10.5, 10.75])
    np.testing.assert_array_equal(recording[1].intensities, ARRAYS[2])
    # The file's x is the tracker's y, its y the tracker's -x.
    place_mm = np.array([-20 + 0.3, 5 + 1.2, -30 + 3.3])
    wanted = [-place_mm[1] + 4, place_mm[0] + 5, place_mm[2] - 7]
    np.testing.assert_allclose(place(recording[1], [1, 2, 3]), wanted)
    X_WL = recording.X_WL(1)
    np.testing.assert_allclose(1e3 * X_WL.multiply(1e-3 * place_mm), wanted)
    still = Recording(path, poses="none")
    assert len(still) == 4
    np.testing.assert_allclose(place(still[2], [1, 2, 3]), place_mm)


def change(path, old, new):
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))


def nan_filled(path):
    write_sequence_nrrd(path, [np.full(SHAPE, np.nan, np.float32)] * 2)


def posed(matrix):
    """Fields of volumes that all have one pose."""
    row = " ".join(map(str, matrix.ravel()))
    return tracked(4) | {f"Seq_Frame000{k}_ProbeToTrackerTransform": row for k in range(4)}


FAULTS = {
    "empty.seq.nrrd": (lambda path: path.write_bytes(b""), "it is empty"),
    "flat.nrrd": (
        lambda p: nrrd.write(str(p), ARRAYS[0][0]),
        "sizes: '8 5' is not allowed; it is one image",
    ),
    "folder.seq.nrrd": (lambda path: path.mkdir(), "it is a folder"),
    "missing.nrrd": (lambda path: None, "there is no such file"),
    "volume.png": (lambda path: path.write_bytes(b"PNG" * 99), "this file type"),
    "nan.seq.nrrd": (nan_filled, "volume 0 holds values that are not finite"),
    "cut.seq.nrrd": (
        lambda p: p.write_bytes(write_sequence_nrrd(p, ARRAYS, encoding="raw").read_bytes()[:-9]),
        "truncated",
    ),
    "cut_compressed.mha": (
        lambda p: p.write_bytes(
            write_meta_image(p, ARRAYS, tracked(4), compressed=True).read_bytes()[:-300]
        ),
        "truncated",
    ),
    "no_times.mha": (lambda p: write_meta_image(p, ARRAYS), "--volume-rate"),
    "invalid.mha": (
        lambda p: write_meta_image(p, ARRAYS, tracked(4, invalid=range(4))),
        "all of its 4 volumes are invalid: ProbeToTrackerTransformStatus is not OK in 4",
    ),
    "standing.seq.nrrd": (
        lambda p: write_sequence_nrrd(p, ARRAYS, times=[0] * 4),
        "do not rise: all are 0 s; give their rate (--volume-rate)",
    ),
    "falling.seq.nrrd": (
        lambda p: write_sequence_nrrd(p, ARRAYS, times=[1.5, 1, 0.5, 0]),
        "do not rise: that of volume 0 is 1.5 s, and that of volume 1 1 s; give their rate",
    ),
    "ms.seq.nrrd": (
        lambda p: write_sequence_nrrd(p, ARRAYS, times=[1764331200000 + 50 * k for k in range(4)]),
        "are out of range (+-1e+11 s): 1764331200000 s, as if in ms since 1970; give their rate",
    ),
    "unstamped.mha": (
        lambda p: write_meta_image(
            p, ARRAYS, tracked(4) | {f"Seq_Frame000{k}_Timestamp": "x" for k in range(1, 4)}
        ),
        "are missing in 3 of 4; give their rate",
    ),
    "scaled.mha": (
        lambda p: write_meta_image(p, ARRAYS, posed(np.diag([0.7, 0.7, 0.7, 1]))),
        "is not a rotation: its axes are scaled by 0.7",
    ),
    "mirrored.mha": (
        lambda p: write_meta_image(p, ARRAYS, posed(np.diag([1, 1, -1, 1]))),
        "volume 0: Probe to Tracker: ProbeToTracker: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], "
        "[0.0, 0.0, -1.0]] is not a rotation: it is mirrored",
    ),
    "askew.mha": (
        lambda p: write_meta_image(
            p, ARRAYS, posed(np.eye(4) + 0.2 * np.eye(4, k=1) * [1, 1, 0, 0])
        ),
        "is not a rotation: its axes are not at right angles",
    ),
    "transposed.mha": (
        lambda p: write_meta_image(p, ARRAYS, posed(np.eye(4) + np.eye(4)[[3]].T * [9, 8, 7, 0])),
        "its translation is in the last row: transposed?",
    ),
    "spacing.seq.nrrd": (
        lambda p: change(write_sequence_nrrd(p, ARRAYS), b"(0.29999999999999999", b"(0.0"),
        "voxel spacing [0.0, 0.6, 1.1] mm; it must be above 0",
    ),
    "liar.seq.nrrd": (
        lambda p: change(write_sequence_nrrd(p, ARRAYS), b"sizes: 6 8 5", b"sizes: 6 8 5000000"),
        "truncated, or its header is wrong",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_one_line_that_names_the_file(tmp_path, name):
    make, message = FAULTS[name]
    path = tmp_path / name
    make(path)
    with pytest.raises(ConfigurationError) as error:
        for _ in Recording(path):
            pass
    text = str(error.value)
    assert str(path) in text
    assert message in text
    assert "\n" not in text


@pytest.mark.parametrize("name", ["more.seq.nrrd", "more.mha"])
def test_data_without_a_header_are_told(tmp_path, name):
    """A size that is too small shears every volume."""
    path = tmp_path / name
    if name.endswith("mha"):
        write_meta_image(path, ARRAYS, tracked(4))
    else:
        write_sequence_nrrd(path, ARRAYS, encoding="raw")
    assert not any("more than" in note for note in Recording(path).notes)
    path.write_bytes(path.read_bytes() + bytes(240))
    assert "the data hold 240 bytes more than the header" in " ".join(Recording(path).notes)


def test_a_thousand_volumes_take_the_memory_of_a_few(tmp_path):
    """16 MB of volumes, gzip and list axis first: at no time are more than some of them held."""
    shape = (20, 40, 20)
    header = (
        "NRRD0004\ntype: uint8\ndimension: 4\nspace: LPS\nsizes: 1000 20 40 20\n"
        "space directions: none (1,0,0) (0,1,0) (0,0,1)\nkinds: list domain domain domain\n"
        'labels: "time" "" "" ""\nencoding: gzip\n'
        f"axis 0 index type:=numeric\naxis 0 index values:={' '.join(map(str, range(1000)))}\n\n"
    )
    numbers = np.arange(1000, dtype=np.uint16).astype(np.uint8)
    path = tmp_path / "long.seq.nrrd"
    path.write_bytes(header.encode() + gzip.compress(np.tile(numbers, np.prod(shape)).tobytes(), 1))
    recording = Recording(path)
    tracemalloc.start()
    for k, volume in enumerate(recording):
        assert volume.intensities.shape == shape
        assert (volume.intensities == k % 256).all()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50 * np.prod(shape)
