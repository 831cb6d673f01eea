"""Structures from YAML, and beside a needle."""

import numpy as np
import pytest
from renderers import DOWN, make_renderer, shift, still

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import load_typed
from sonoservo.systems.ultrasound.simulation.structures.kinds import (
    Bone,
    Calcification,
    Fascia,
    Gas,
    NWires,
    RestingNeedle,
    Vessel,
)
from sonoservo.systems.ultrasound.simulation.structures.structure import BesideNeedle
from sonoservo.systems.ultrasound.simulation.tissue import Tissue, load_tissue

KINDS = [Bone, Vessel, Fascia, Calcification, Gas, NWires, RestingNeedle]
ENTRY, DIRECTION = [-0.06, 0.01, -0.02], [0.8, 0.1, -0.59]


def distance_from_axis(point):
    along = np.array(DIRECTION) / np.linalg.norm(DIRECTION)
    offset = np.subtract(point, ENTRY)
    return np.linalg.norm(offset - (offset @ along) * along), offset @ along


@pytest.mark.parametrize("angle_deg", [-90, 35])
def test_place_beside_needle(angle_deg):
    beside = BesideNeedle(distance=3e-3, along=0.05, angle_deg=angle_deg)
    place = beside.resolve(ENTRY, DIRECTION, 1e-3)
    assert distance_from_axis(place) == pytest.approx((4e-3, 0.05))
    height = place[2] - (beside.resolve(ENTRY, DIRECTION, -3e-3))[2]
    assert np.sign(round(height, 9)) == np.sign(round(np.sin(np.deg2rad(angle_deg)), 9))


@pytest.mark.parametrize("kind", KINDS)
def test_any_structure_goes_beside_the_needle(kind):
    tissue = Tissue(structures=[kind(beside_needle=BesideNeedle(distance=2e-3))])
    placed = tissue.placed(ENTRY, DIRECTION).structures[0]
    assert placed.beside_needle is None
    distance, along = distance_from_axis(placed.middle)
    assert distance == pytest.approx(2e-3 + placed.reach)
    assert along == pytest.approx(0.04)


def test_structures_come_from_yaml():
    data = {
        "structures": [
            {"kind": "vessel", "radius": 4e-3},
            {"kind": "calcification", "beside_needle": {"distance": 0.002}},
            "n_wires",
            {"kind": "needle", "echo": {"tip": "blunt"}},
        ],
        "fat": {"thickness": 0.01},
    }
    tissue = load_typed(Tissue, data, "mine")
    assert [each.kind for each in tissue.structures] == [
        "vessel", "calcification", "n_wires", "needle",
    ]  # fmt: skip
    assert tissue.structures[0].radius == 4e-3
    assert tissue.structures[1].beside_needle.distance == 0.002
    assert tissue.structures[3].echo.tip == "blunt"


@pytest.mark.parametrize(
    ("structure", "message"),
    [
        ({"kind": "bones"}, "unknown kind 'bones'; did you mean 'bone'"),
        ({"kind": "vessel", "path": [[0, 0, 0]]}, "path.*at least two points"),
        ({"kind": "calcification", "centre": [0, 0, -40]}, "centre: .*three coordinates in m"),
    ],
)
def test_what_is_out_of_range_is_named(structure, message):
    with pytest.raises(ConfigurationError, match=message) as caught:
        load_typed(Tissue, {"structures": [structure]}, "mine")
    assert "\n" not in str(caught.value)


def test_n_wires_tell_the_frame_where_it_is():
    """The slanting wire divides the width as the plane divides the length (Comeau 1998)."""
    wires = NWires(length=0.04, width=0.02, azimuth_deg=90).ends()
    for share in (0.1, 0.5, 0.8):
        crossings = wires[:, 0] + share * (wires[:, 1] - wires[:, 0])
        assert crossings[:, 1] == pytest.approx([crossings[0, 1]] * 3)
        ratio = (crossings[1, 0] - crossings[0, 0]) / (crossings[2, 0] - crossings[0, 0])
        assert ratio == pytest.approx(share)


def test_a_seed_draws_the_layout_and_those_held_out_are_mirrored():
    """Distances stay; angles and depths differ by at most 20 deg and 10 mm from those stated."""
    tissue = load_tissue("clinic")
    stated = tissue.placed(ENTRY, DIRECTION).structures
    axis = np.asarray(DIRECTION) / np.linalg.norm(DIRECTION)

    def where(structure):
        away = structure.middle - ENTRY
        along = away @ axis
        across = np.cross([0, 0, 1], axis)
        across /= np.linalg.norm(across)
        aside = away - along * axis
        up = np.cross(axis, across)
        return along, np.linalg.norm(aside), np.rad2deg(np.arctan2(aside @ up, aside @ across))

    for seed, mirrored in ((7, True), (99, True), (100, False), (101, False)):
        drawn = tissue.placed(ENTRY, DIRECTION, seed).structures
        again = tissue.placed(ENTRY, DIRECTION, seed).structures
        assert [each.middle.tolist() for each in drawn] == [each.middle.tolist() for each in again]
        for before, here, there in zip(tissue.structures, stated, drawn, strict=True):
            if before.beside_needle is None:
                assert 0 < np.abs(there.middle - here.middle).max() <= 0.01
                continue
            (s, distance, angle), (t, same, turned) = where(here), where(there)
            assert same == pytest.approx(distance, abs=1e-6)
            assert abs(t - s) <= 0.01
            wanted = 180 - angle if mirrored else angle
            assert abs((turned - wanted + 180) % 360 - 180) <= 20 + 1e-6


def test_resting_needle_echoes_as_one_in_the_hand():
    resting = RestingNeedle(start=[-0.03, 0, -0.045], end=[0.01, 0, -0.045])
    few = {"sector": 0.3, "frames": 3, "volume_rate": 10}
    with_it, without = (make_renderer(Tissue(structures=each), **few) for each in ([resting], []))
    X = still(with_it, shift(0, 0, 0.1) @ DOWN)
    there = with_it.tissue_echo(X, 1)
    held = without.echo(X, [resting.needle()] * 3, 1)
    levels = [np.sort(np.abs(echo).ravel())[-200:].mean() for echo in (there, held)]
    assert 20 * np.log10(levels[0] / levels[1]) == pytest.approx(0, abs=1.5)


def test_placement_needs_a_needle():
    with pytest.raises(ValueError, match="beside_needle.*placed by the way of a needle"):
        make_renderer(Tissue(structures=[Gas(beside_needle=BesideNeedle())]))
