"""A volume comes back with the same voxel at the same place, however it is stored."""

import gzip
import os
import re
import resource
import zlib
from itertools import permutations, product
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydrake.math import RollPitchYaw

from sonoservo.systems.files import nrrd_reader
from sonoservo.systems.files.nrrd_reader import KEYS
from sonoservo.systems.files.plus_fields import FRAME_FIELDS, SEQUENCE_FIELDS
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.volume_file import FieldUse
from sonoservo.systems.recording import Recording, meta_image
from sonoservo.systems.recording.tracked_frames import TrackedFrames

SHAPE = (5, 4, 3)
GREY = np.random.default_rng(1).permutation(np.arange(1, 61)).reshape(SHAPE)
STEPS, ORIGIN = np.array([0.3, 0.6, 1.1]), np.array([-20.0, 5.0, -30.0])
NRRD_TYPES = {
    "u1": "uchar", "i1": "int8", "u2": "unsigned short", "i2": "short", "u4": "uint32", "i4": "int",
    "u8": "uint64", "i8": "longlong", "f4": "float", "f8": "double",
}  # fmt: skip
META_TYPES = {
    "u1": "MET_UCHAR", "i1": "MET_CHAR", "u2": "MET_USHORT", "i2": "MET_SHORT", "u4": "MET_UINT",
    "i4": "MET_INT", "u8": "MET_ULONG_LONG", "i8": "MET_LONG_LONG", "f4": "MET_FLOAT",
    "f8": "MET_DOUBLE",
}  # fmt: skip
SPACES = {
    "left-posterior-superior": (1, 1, 1),
    "RAS": (-1, -1, 1),
    "Left-Anterior-Superior": (1, -1, 1),
}
UNITS = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3}
LETTERS = ["".join(each) for xyz in product("MU", "FN", "AD") for each in permutations(xyz)]
AXES = {"M": (0, 1), "U": (0, -1), "F": (1, 1), "N": (1, -1), "A": (2, 1), "D": (2, -1)}


@st.composite
def grids(draw):
    """A view of the array with permuted and flipped axes, its steps and origin in LPS, and R."""
    order = draw(st.permutations(range(3)))
    signs = np.array(draw(st.tuples(*[st.sampled_from([1, -1])] * 3)))
    R = RollPitchYaw(*draw(st.tuples(*[st.sampled_from([0, 0.2, -0.3])] * 3))).ToRotationMatrix()
    R = R.matrix()
    backwards = tuple(slice(None, None, int(sign)) for sign in signs)
    array = GREY.transpose(order)[backwards]
    directions = (R * STEPS)[:, order] * signs
    last = np.where(signs < 0, np.array(GREY.shape)[list(order)] - 1, 0)
    return array, directions, R @ ORIGIN - directions @ last, R


def packed(array, code, order):
    return array.astype(f"{order}{code}").tobytes("F")


def assert_same(volume, R):
    """Every voxel has its place in W: R times that in the array's own grid."""
    assert volume.intensities.flags.c_contiguous  # what the kernels are compiled for
    index = np.argwhere(np.ones(volume.intensities.shape))
    found = 1e3 * volume.to_world(volume.position(index))[0]
    own = np.rint(((found @ R) - ORIGIN) / STEPS).astype(int)
    np.testing.assert_allclose(own * STEPS + ORIGIN, found @ R, atol=1e-6)
    np.testing.assert_array_equal(GREY[tuple(own.T)], volume.intensities.ravel())


def listed(vectors):
    return " ".join(
        "none" if v is None else f"({','.join(map(repr, map(float, v)))})" for v in vectors
    )


@st.composite
def nrrd_files(draw):
    """Header lines, data files by name, and what the volume must be."""
    plain = draw(st.integers(0, 3)) == 0  # without directions
    array, directions, origin, R = GREY, np.diag(STEPS), ORIGIN, np.eye(3)
    if not plain:
        array, directions, origin, R = draw(grids())
    code, order = draw(st.sampled_from(sorted(NRRD_TYPES))), draw(st.sampled_from("<>"))
    sequence = "" if plain else draw(st.sampled_from(["", "last", "first", "fourth"]))
    space, unit = draw(st.sampled_from(sorted(SPACES))), draw(st.sampled_from(sorted(UNITS)))
    sizes, kinds = list(array.shape), ["domain"] * 3
    stack = array
    if sequence:
        stack = np.stack([array, array], axis=0 if sequence == "first" else -1)
        at = 0 if sequence == "first" else 3
        sizes.insert(at, 2)
        kinds.insert(at, {"first": "list", "last": "time", "fourth": "domain"}[sequence])
    lines = [
        f"type: {NRRD_TYPES[code]}",
        f"dimension: {len(sizes)}",
        f"sizes: {' '.join(map(str, sizes))}",
    ]
    if plain:
        first, steps = origin / UNITS[unit], np.diag(directions) / UNITS[unit]
        center = draw(st.sampled_from(["cell", "node", "???", ""]))
        cell = center != "node"
        lines += [f"axis mins: {' '.join(map(repr, (first - 0.5 * cell * steps).tolist()))}",
                  *([f"centers: {' '.join([center] * 3)}"] if center else []),
                  f"units: {' '.join([chr(34) + unit + chr(34)] * 3)}"]  # fmt: skip
        if draw(st.booleans()):
            lines.append(f"spacings: {' '.join(map(repr, steps.tolist()))}")
        else:
            upper = first + steps * (np.array(sizes) - 1 + 0.5 * cell)
            lines.append(f"axis maxs: {' '.join(map(repr, upper.tolist()))}")
    else:
        scale = np.array(SPACES[space]) / UNITS[unit]
        vectors = list((scale[:, np.newaxis] * directions).T)
        place, units = scale * origin, [unit] * 3
        if sequence == "fourth":
            vectors = [*(np.append(v, 0) for v in vectors), [0, 0, 0, 0.5]]
            place, units = np.append(place, 0), [*units, "s"]
            space += "-time" if "-" in space else "T"
        elif sequence:
            vectors.insert(at, None)
        units = " ".join(f'"{each}"' for each in units)
        lines += [f"space: {space}", f"space directions: {listed(vectors)}",
                  f"space origin: {listed([place])}", f"space units: {units}"]  # fmt: skip
    lines += [f"kinds: {' '.join(kinds)}", f"endian: {'big' if order == '>' else 'little'}"]
    twice = draw(st.booleans())
    if twice:
        lines += [
            lines[0],  # a field may stand twice, but not for ITK
            "# a comment",
            "thicknesses: " + " ".join(["nan"] * len(sizes)),
            "note:=made by hand",
        ]
    data = packed(stack, code, order)
    gz, skip, newlines = (
        draw(st.booleans()),
        draw(st.sampled_from([0, 7])),
        draw(st.sampled_from([0, 2])),
    )
    where = draw(st.sampled_from(["attached", "detached", "list", "pattern", "last bytes"]))
    files = {}
    if where in ("list", "pattern"):
        count = sizes[-1]
        step = len(data) // count
        names = [f"ä{k:02d}.raw" for k in range(count)]
        pieces = [data[k * step : (k + 1) * step] for k in range(count)]
        lines.append(
            "data file: LIST" if where == "list" else f"data file: ä%02d.raw 0 {count - 1} 1"
        )
    else:
        names, pieces = [""], [data]
        if where == "detached":
            names = ["ä.raw"]
            lines.append("data file: ä.raw")
    if where == "last bytes":
        gz, newlines = False, 0
        pieces = [b"before" + pieces[0]]
        lines.append("byte skip: -1")
    else:
        lines += [f"byte skip: {skip}", f"line skip: {newlines}"]
        half = len(pieces[0]) // 2
        pieces = [b"\1" * skip + each for each in pieces]
        if gz:
            pieces = [gzip.compress(each[:half]) + gzip.compress(each[half:]) for each in pieces]
        pieces = [b"line\n" * newlines + each for each in pieces]
    lines.append(f"encoding: {'gzip' if gz else 'raw'}")
    if where == "list":  # the last field of a header
        lines.remove("data file: LIST")
        lines += ["data file: LIST", *names]
    files = dict(zip(names, pieces, strict=True))
    plain = not (twice or skip or newlines or where == "last bytes" or gz)
    return lines, files, R, bool(sequence), draw(st.sampled_from("LRPASI")), plain


def check_nrrd(folder, case):
    lines, files, R, sequence, depth, plain = case
    path = folder / ("a.nrrd" if "" in files else "a.nhdr")
    path.write_bytes("\n".join(["NRRD0005", *lines, "", ""]).encode() + files.get("", b""))
    for name, data in files.items():
        if name:
            (folder / name).write_bytes(data)
    rate = 2.0 if sequence else None
    recording = Recording(path, depth=depth, window=(0, 255), volume_rate=rate)
    assert len(recording) == 1 + sequence
    for volume in (*recording, recording[0]):  # and backwards
        assert_same(volume, R)
        # The sound goes along Y of the probe, and so where it was said to go.
        axes = dict(zip("LPSRAI", [*np.eye(3), *-np.eye(3)], strict=True))
        assert volume.X_WP.rotation().matrix()[:, 1] @ axes[depth] > 0.5
    # ITK knows neither other units nor axis maxs nor names that are not ASCII.
    header = "\n".join(lines)
    strange = any(word in header for word in ('"cm"', '"m"', '"um"', "axis maxs", "ä"))
    if plain and not sequence and not strange:
        referee(path, recording[0])


def referee(path, volume):
    """Ask SimpleITK where the brightest voxel lies."""
    image = SimpleITK.ReadImage(str(path))
    numbers = SimpleITK.GetArrayFromImage(image).T
    brightest = np.unravel_index(numbers.argmax(), numbers.shape)
    ours = np.unravel_index(volume.intensities.argmax(), volume.intensities.shape)
    place = 1e3 * volume.to_world(volume.position([ours]))[0][0]
    told = image.TransformIndexToPhysicalPoint(tuple(map(int, brightest)))
    np.testing.assert_allclose(place, told, atol=1e-6)


@st.composite
def meta_files(draw):
    array, directions, origin, R = draw(grids())
    code, order = draw(st.sampled_from(sorted(META_TYPES))), draw(st.sampled_from("<>"))
    unit, count = draw(st.sampled_from(["mm", "cm", "um"])), draw(st.sampled_from([1, 2]))
    n = 3 if count == 1 else 4
    letters = "MFA" if draw(st.booleans()) else draw(st.sampled_from(LETTERS))
    axes, signs = zip(*(AXES[letter] for letter in letters), strict=True)
    # The geometry is that of the image as PLUS turns it, but for the sizes of a voxel.
    stored = array.transpose(axes)[tuple(slice(None, None, sign) for sign in signs)]
    stack = stored if count == 1 else np.stack([stored] * count, axis=-1)
    steps = np.linalg.norm(directions, axis=0)
    matrix = np.eye(n)
    matrix[:3, :3] = (directions / steps).T
    spacing, place = np.ones(n), np.zeros(n)
    spacing[:3], place[:3] = steps[list(axes)] / UNITS[unit], origin / UNITS[unit]
    if count > 1:
        spacing[3] = 0.5
    names = draw(st.sampled_from([("Offset", "TransformMatrix", "ElementSpacing"),
                                  ("Position", "Rotation", "ElementSize"),
                                  ("Origin", "Orientation", "ElementSpacing")]))  # fmt: skip
    numbers = lambda values: " ".join(map(repr, np.asarray(values, float).ravel().tolist()))  # noqa: E731
    lines = ["ObjectType = Image", f"NDims = {n}", f"DimSize = {' '.join(map(str, stack.shape))}",
             f"{names[0]} = {numbers(place)}", f"{names[1]} = {numbers(matrix)}",
             f"{names[2]} = {numbers(spacing)}", f"ElementType = {META_TYPES[code]}",
             f"{draw(st.sampled_from(['BinaryData', 'Element']))}ByteOrderMSB = {order == '>'}",
             "AnatomicalOrientation = RAI"]  # fmt: skip
    if unit != "mm":
        lines.append(f"DistanceUnits = {unit}")
    plain = letters == "MFA" and unit == "mm"
    if not plain:
        lines.append(f"UltrasoundImageOrientation = {letters}")
    data = packed(stack, code, order)
    where = draw(st.sampled_from(["local", "beside", "list", "pattern", "last bytes", "header"]))
    compressed = where in ("local", "beside") and draw(st.booleans())
    lines.append(f"CompressedData = {compressed}")
    if compressed:
        data = zlib.compress(data)
        lines.append(f"CompressedDataSize = {len(data)}")  # which ITK needs
    files, source = {"": data}, "LOCAL"
    if where in ("list", "pattern"):
        pieces = int(np.prod(stack.shape[2:]))
        step = len(data) // pieces
        files = {f"ä{k:02d}.raw": data[k * step : (k + 1) * step] for k in range(pieces)}
        source = (
            f"ä%02d.raw 0 {pieces - 1} 1" if where == "pattern" else "\n".join(["LIST", *files])
        )
    elif where != "local":
        files, source = {"ä.raw": (b"" if where == "beside" else b"before") + data}, "ä.raw"
        lines += {"last bytes": ["HeaderSize = -1"], "header": ["HeaderSize = 6"]}.get(where, [])
    return [*lines, f"ElementDataFile = {source}"], files, R, count, plain


def check_meta(folder, case):
    lines, files, R, count, plain = case
    path = folder / ("a.mha" if "" in files else "a.mhd")
    path.write_bytes("\n".join([*lines, ""]).encode() + files.get("", b""))
    for name, data in files.items():
        if name:
            (folder / name).write_bytes(data)
    recording = Recording(path, window=(0, 255))
    np.testing.assert_allclose(recording.times, 0.5 * np.arange(count))
    for volume in recording:
        assert_same(volume, R)
    if plain and count == 1 and path.suffix == ".mha":
        referee(path, recording[0])


CASES = {"nrrd": (nrrd_files(), check_nrrd), "meta": (meta_files(), check_meta)}
QUIET = {
    "deadline": None,
    "suppress_health_check": [
        HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.filter_too_much,
    ],
}  # fmt: skip


@pytest.mark.parametrize("examples", [40, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", CASES)
def test_a_volume_comes_back_however_it_is_stored(tmp_path, name, examples):
    cases, check = CASES[name]

    @given(case=cases)
    @settings(max_examples=examples, derandomize=True, **QUIET)
    def run(case):
        check(tmp_path, case)

    run()


def test_a_series_may_have_more_files_than_may_be_open(tmp_path):
    count = 80
    path = tmp_path / "a.mhd"
    names = [f"{k:02d}.raw" for k in range(count)]
    for k, name in enumerate(names):
        (tmp_path / name).write_bytes(np.full(8, k, np.uint8).tobytes())
    lines = ["NDims = 4", f"DimSize = 2 2 2 {count}", "ElementType = MET_UCHAR"]
    path.write_text("\n".join([*lines, "ElementDataFile = LIST", *names]) + "\n")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (len(os.listdir("/proc/self/fd")) + 20, hard))
    try:
        recording = Recording(path, window=(0, 255), volume_rate=2.0)
        greys = [float(volume.intensities.max()) for volume in recording]
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    np.testing.assert_allclose(greys, np.arange(count), atol=0.5)


@pytest.mark.parametrize("suffix", ["igs.mha", "igs.nrrd"])
@pytest.mark.parametrize("letters", ["MF", "UN", "FM", "NU"])
def test_frames_come_back_however_plus_stores_them(tmp_path, letters, suffix):
    frames = np.stack([GREY[..., 0], GREY[..., 1]], axis=-1)
    axes, signs = zip(*(AXES[letter] for letter in letters), strict=True)
    stored = frames.transpose(*axes, 2)[tuple(slice(None, None, sign) for sign in signs)]
    poses = [f"0.3 0 0 1 0 0.6 0 2 0 0 1 {k} 0 0 0 1" for k in range(2)]
    sizes, data = " ".join(map(str, stored.shape)), packed(stored, "u1", "<")
    fields = [(f"Seq_Frame000{k}_{name}", value) for k in range(2) for name, value in (
        ("ImageToReferenceTransform", poses[k]), ("Timestamp", str(1 + k)))]  # fmt: skip
    path = tmp_path / f"a.{suffix}"
    if suffix == "igs.mha":
        lines = ["NDims = 3", f"DimSize = {sizes}", "ElementType = MET_UCHAR",
                 f"UltrasoundImageOrientation = {letters}",
                 *(f"{key} = {value}" for key, value in fields),
                 "ElementDataFile = LOCAL", ""]  # fmt: skip
    else:
        lines = ["NRRD0004", "type: uchar", "dimension: 3", f"sizes: {sizes}", "encoding: raw",
                 f"kinds: domain domain {'list' if letters[0] in 'MU' else 'domain'}",
                 f"ultrasound image orientation:={letters}",
                 *(f"{key}:={value}" for key, value in fields), "", ""]  # fmt: skip
    path.write_bytes("\n".join(lines).encode() + data)
    read = TrackedFrames(path)
    for k in range(2):
        np.testing.assert_array_equal(read[k], frames[..., k])
    np.testing.assert_allclose(1e3 * read.X_WI[1, :3, 3], [1, 2, 1])


REFUSED = {
    "RF": (["UltrasoundImageType = RF_REAL"], "radio-frequency samples"),
    "orientation": (["UltrasoundImageOrientation = MX"], "UltrasoundImageOrientation"),
    "channels": (["ElementNumberOfChannels = 2"], "3 or 4 for colours"),
    "unit": (["DistanceUnits = inch"], "DistanceUnits"),
    "axes": (["NDims = 4"], "NDims: '4' is not allowed; DimSize has 3 axes"),
    "misspelt": (["ElementSpacng = 1 1 1"], "did you mean 'ElementSpacing'"),
    "time": (["Seq_Frame0000_TimeStamp = 1"], "did you mean 'Seq_Frame0000_Timestamp'"),
    "transform": (["Seq_Frame0000_ImageToRTransfrm = 1"], "'Seq_Frame0000_ImageToRTransform'"),
    "status": (["Seq_Frame0000_ImageToRTransformStats = OK"], "ImageToRTransformStatus'"),
    "bare": (["DimSize ="], "DimSize: '' is not allowed; expected finite numbers: 3 or 4"),
    "line": (["Comment"], "Comment: it has no value"),
    "comma": (["ElementSpacing = 0,7 0,7 0,7"], "numbers: 3, with a comma for a point"),
}


NRRD_REFUSED = {
    "space": (["space: heaven"], "anatomical names"),
    "twice": (["space: LPS", "space: RAS"], "it stands twice"),
    "vector": (["kinds: complex domain domain"], "complex"),
    "unit": (["space: LPS", 'space units: "inch" "mm" "mm"'], "space units"),
    "encoding": (["encoding: hex"], "twice|not supported"),
    "files": (["data file: LIST", "a.raw", "b.raw"], "no file .a.raw"),
    "misspelt field": (["spacing: 1 1 1"], "spacing: unknown; did you mean 'spacings'"),
    "misspelt key": (["decibel_per_level:=1"], "did you mean 'decibels_per_level'"),
    "colours": (["kinds: list 3-color domain"], "'list 3-color domain' is not allowed"),
}


HEADS = {
    "a.mha": (["DimSize = 5 4 3", "ElementType = MET_UCHAR"], ["ElementDataFile = LOCAL", ""]),
    "a.nrrd": (
        ["NRRD0004", "type: uchar", "dimension: 3", "sizes: 5 4 3", "encoding: raw"], ["", ""]
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("file", "lines", "message"),
    [
        *(("a.mha", *case) for case in REFUSED.values()),
        *(("a.nrrd", *case) for case in NRRD_REFUSED.values()),
    ],
    ids=[*REFUSED, *NRRD_REFUSED],
)
def test_what_headers_say_and_is_not_understood_is_refused(tmp_path, file, lines, message):
    first, last = HEADS[file]
    head = "\n".join([*first, *lines, *last]).encode()
    (tmp_path / file).write_bytes(head + packed(GREY, "u1", "<") * 2)
    with pytest.raises(ConfigurationError, match=message):
        Recording(tmp_path / file)


@pytest.mark.parametrize("where", ["first", "last"])
@pytest.mark.parametrize("kind", ["vector", "RGBA-color"])
def test_colours_are_refused_or_their_luminance_is_taken(tmp_path, kind, where):
    channels = 4 if kind == "RGBA-color" else 3
    colours = np.stack([GREY, GREY, GREY, GREY][:channels], axis=0 if where == "first" else -1)
    sizes, kinds = list(SHAPE), ["domain"] * 3
    at = 0 if where == "first" else 3
    sizes.insert(at, channels)
    kinds.insert(at, kind)
    head = ["NRRD0004", "type: uchar", "dimension: 4", f"sizes: {' '.join(map(str, sizes))}",
            "encoding: raw", f"kinds: {' '.join(kinds)}", "", ""]  # fmt: skip
    (tmp_path / "a.nrrd").write_bytes("\n".join(head).encode() + packed(colours, "u1", "<"))
    with pytest.raises(ConfigurationError, match="colours.*--luminance"):
        Recording(tmp_path / "a.nrrd")
    (volume,) = Recording(tmp_path / "a.nrrd", luminance=True)
    np.testing.assert_array_equal(volume.intensities, GREY)


def test_unknown_fields_and_missing_geometry_are_said(tmp_path):
    head = "\n".join([*HEADS["a.nrrd"][0], "mood:=good", "", ""]).encode()
    (tmp_path / "a.nrrd").write_bytes(head + packed(GREY, "u1", "<"))
    notes = " ".join(Recording(tmp_path / "a.nrrd").notes)
    for text in ("have no effect: mood", "1 mm is taken", "no position"):
        assert text in notes


def test_index_values_without_a_known_unit_of_time_are_no_times(tmp_path):
    head = "\n".join([
        "NRRD0004", "type: uchar", "dimension: 4", f"sizes: {' '.join(map(str, SHAPE))} 2",
        "encoding: raw", "kinds: domain domain domain list", "spacings: 1 1 1 nan",
        "axis 3 index values:=10 20", "", "",
    ])  # fmt: skip
    (tmp_path / "a.nrrd").write_bytes(head.encode() + 2 * packed(GREY, "u1", "<"))
    assert "no unit of time" in " ".join(Recording(tmp_path / "a.nrrd", volume_rate=4).notes)
    with pytest.raises(ConfigurationError, match="--volume-rate.*no unit of time"):
        Recording(tmp_path / "a.nrrd")
    head = head.replace("nan", 'nan\nlabels: "" "" "" "time"\naxis 3 index units:=min')
    (tmp_path / "a.nrrd").write_bytes(head.encode() + 2 * packed(GREY, "u1", "<"))
    with pytest.raises(ConfigurationError, match="index units: 'min' is not.*use s, ms or us"):
        Recording(tmp_path / "a.nrrd")


def test_the_documentation_lists_what_becomes_of_each_field():
    text = (Path(__file__).parents[3] / "notebooks" / "docs" / "your_data.md").read_text()
    rows = re.findall(r"^\| (used|checked|without effect) \| (.*) \|$", text, re.MULTILINE)
    said = [(use, set(re.findall("`(.*?)`", names))) for use, names in rows]
    keys = {f"axis N {key}" if key.startswith("index") else key: use for key, use in KEYS.items()}
    plus = {
        f"Seq_Frame0012_{'Name' * name.startswith('Transform')}{name}": use
        for name, use in FRAME_FIELDS.items()
    }
    tables = [meta_image.FIELDS, nrrd_reader.FIELDS | keys, SEQUENCE_FIELDS | plus]
    wanted = [
        (use.value, names)
        for table in tables
        for use in FieldUse
        if (names := {name for name, of in table.items() if of is use})
    ]
    assert said == wanted
