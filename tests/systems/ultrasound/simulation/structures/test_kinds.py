"""Echoes of surfaces against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from renderers import DEEP, make_renderer, still

from sonoservo.systems.ultrasound.simulation.structures.kinds import (
    Bone,
    Calcification,
    Fascia,
    Gas,
    Vessel,
)

FACE = 0.1
"""Depth of the probe's face below the tissue's top, in m."""


def at_depth(depth, x=0.0, y=0.0):
    return [x, y, -FACE - depth]


def rendered(*structures, times=0.0, frame=13, **changes):
    """Echoes of tissue with structures, and of the same tissue without: (lines, samples) each."""
    renderer = make_renderer(replace(DEEP, structures=list(structures), **changes), sector=0.4)
    bare = make_renderer(replace(DEEP, **changes), sector=0.4)
    X, t = still(renderer), np.full(27, times)
    with_them = renderer.tissue_echo(X, 1, t)[frame]
    return renderer, with_them, bare.tissue_echo(X, 1, t)[frame]


def mirror(depth, dip_deg=0.0, level_db=30.0):
    return Fascia(
        centre=at_depth(depth), size=[0.04, 0.04], dip_deg=dip_deg, wave_height=0,
        level_db=level_db, diffuse_db=-100, shadow=0,
    )  # fmt: skip


def peak_db(renderer, echo, depth, reach=2e-3):
    """Highest level on the middle line near a depth."""
    line = np.abs(echo[renderer.geometry.lines // 2])
    depths = renderer.geometry.sample_pitch * np.arange(len(line))
    return 20 * np.log10(line[np.abs(depths - depth) < reach].max() + 1e-12)


@pytest.mark.parametrize("angle_deg", [1, 3])
def test_mirror_fades_with_the_angle_as_a_gaussian_beam_does(angle_deg):
    """exp(-(2 k sin a)^2 sigma^2 / 2): the Fourier transform of the beam's section."""
    renderer, flat, bare = rendered(mirror(0.06))
    _, tilted, _ = rendered(mirror(0.06, angle_deg))
    sigma = renderer.beam.lateral[int(0.06 / renderer.geometry.sample_pitch)]
    slope = 2 * 2 * np.pi / renderer.beam.wavelength * np.sin(np.deg2rad(angle_deg))
    expected = -20 * np.log10(np.e) * (slope * sigma) ** 2 / 2
    # Lines fan out: the beam's own angle is up to a half of the line pitch.
    spread = 20 * np.log10(np.e) * slope * sigma**2 * slope * 0.3 / angle_deg
    straight = peak_db(renderer, flat - bare, 0.06)
    # Wave fronts that are curved in elevation cost a flat mirror up to 2 dB.
    assert straight == pytest.approx(30, abs=2)
    measured = peak_db(renderer, tilted - bare, 0.06) - straight
    assert measured == pytest.approx(expected, abs=1 + spread)


def test_bone_reverberates_at_multiples_of_its_distance_from_the_face():
    depth = 0.022
    bone = Bone(
        start=at_depth(depth + 0.004, x=-0.03), end=at_depth(depth + 0.004, x=0.03), width=0.3,
        thickness=0.008, diffuse_db=-100,
    )  # fmt: skip
    renderer, echo, _ = rendered(bone)
    line = np.abs(echo[renderer.geometry.lines // 2])
    pitch = renderer.geometry.sample_pitch
    levels = []
    for times in (1, 2, 3):
        middle = round(times * depth / pitch)
        near = slice(middle - 6, middle + 7)
        assert middle - 6 + line[near].argmax() == pytest.approx(times * depth / pitch, abs=1.5)
        levels.append(peak_db(renderer, echo, times * depth))
    # Each return costs what is stated, and what lines that fan out lose on a flat bone.
    steps = np.diff(levels)
    assert steps[0] == pytest.approx(bone.reverberation_db, abs=2)
    assert bone.reverberation_db - 6 < steps[1] < bone.reverberation_db + 1


def test_bone_casts_a_full_shadow_as_wide_as_itself():
    bone = Bone(
        start=at_depth(0.034, y=-0.03), end=at_depth(0.034, y=0.03), width=0.016, thickness=0.008,
        reverberation_db=-100,
    )  # fmt: skip
    renderer, echo, bare = rendered(bone)
    geometry = renderer.geometry
    behind = slice(int(0.045 / geometry.sample_pitch), int(0.08 / geometry.sample_pitch))
    lost = np.sqrt((np.abs(echo[:, behind]) ** 2).mean(axis=1))
    lost /= np.sqrt((np.abs(bare[:, behind]) ** 2).mean(axis=1))
    across = (geometry.array_radius + 0.034) * np.sin(
        geometry.line_pitch * (np.arange(geometry.lines) - (geometry.lines - 1) / 2)
    )
    assert lost[np.abs(across) < 0.006].max() < 1e-3
    assert lost[np.abs(across) > 0.0115].min() > 0.9


def test_calcification_is_as_bright_as_stated_and_shades():
    grain = Calcification(centre=at_depth(0.06), radius=3e-3, level_db=30, shadow=0.8)
    levels, shares = [], []
    for seed in range(6):
        renderer, echo, bare = rendered(grain, seed=seed)
        middle = renderer.geometry.lines // 2
        levels.append(peak_db(renderer, echo, 0.057))
        behind = slice(int(0.067 / renderer.geometry.sample_pitch), None)
        shares.append(np.abs(echo[middle, behind]).sum() / np.abs(bare[middle, behind]).sum())
    assert np.mean(levels) == pytest.approx(30, abs=4)
    assert np.mean(shares) == pytest.approx(0.2, abs=0.05)


def test_gas_rings_down_20_db_in_its_length():
    gas = Gas(
        centre=at_depth(0.03), size=[0.04, 0.04], shadow=1, ring_down_db=-20, ring_down_length=0.04
    )
    renderer, echo, _ = rendered(gas)
    pitch = renderer.geometry.sample_pitch
    depths = np.arange(int(0.036 / pitch), int(0.085 / pitch))
    power = (np.abs(echo[10:-10, depths]) ** 2).mean(axis=0)
    slope = np.polyfit(pitch * depths, 10 * np.log10(power), 1)[0]
    assert slope * 0.04 == pytest.approx(-20, abs=3)


def test_lumen_is_dark_and_pulsates_between_bright_walls():
    vessel = Vessel(
        path=[at_depth(0.05, x=-0.03), at_depth(0.05, x=0.03)], radius=5e-3, pulsation=0.1,
        heart_rate=1.0, attenuation=DEEP.attenuation,
    )  # fmt: skip
    walls = {}
    for time, grown in ((0.25, 0.5e-3), (0.75, -0.5e-3)):
        renderer, echo, bare = rendered(vessel, times=time)
        pitch = renderer.geometry.sample_pitch
        middle = renderer.geometry.lines // 2
        profile = np.abs(echo[middle - 2 : middle + 3]).mean(axis=0)
        inside = slice(int(0.0475 / pitch), int(0.0525 / pitch))
        lumen_db = 20 * np.log10(profile[inside].mean() / np.abs(bare[:, inside]).mean())
        assert lumen_db < -25
        near = slice(int(0.042 / pitch), int(0.0475 / pitch))
        walls[time] = pitch * (near.start + profile[near].argmax()) + grown
        assert peak_db(renderer, echo, 0.045) > 15
    # The wall moves by what the radius grows.
    assert np.ptp(list(walls.values())) < 0.35e-3


def test_blood_weakens_sound_less_than_tissue():
    """4 (a_tissue - a_blood) f r: both ways through a diameter."""
    path = [at_depth(0.04, x=-0.05), at_depth(0.04, x=0.05)]
    vessel = Vessel(path=path, radius=8e-3, attenuation=0.1, level_db=-90, pulsation=0)
    renderer, echo, bare = rendered(vessel)
    behind = slice(int(0.055 / renderer.geometry.sample_pitch), None)
    gain = np.linalg.norm(echo[15:-15, behind]) / np.linalg.norm(bare[15:-15, behind])
    expected = 2 * (DEEP.attenuation - 0.1) * 3.3 * 1.6
    assert 20 * np.log10(gain) == pytest.approx(expected, abs=0.5)
