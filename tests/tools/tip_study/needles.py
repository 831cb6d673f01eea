"""Needles at rest in homogeneous tissue, and the same needles in the terms of the bound."""

from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace

import numpy as np
from pydrake.math import RigidTransform
from renderers import CLEAN

from sonoservo.systems.signals import Needle, Sweep, SweepMotion
from sonoservo.systems.signals.sweep import blur_covariance
from sonoservo.systems.ultrasound import (
    ImagingParameters,
    ScanConversion,
    load_transducer,
    make_grid,
    sweep_geometry,
)
from sonoservo.systems.ultrasound.beam import beam_profile, point_spread
from sonoservo.systems.ultrasound.simulation import NeedleEchoParameters, SweepRenderer, Tissue
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import reverberations
from sonoservo.systems.ultrasound.simulation.pulses import projection_rays
from tip_study.needle_end import NeedleEnd

DIPS, DEPTHS = (0, 15, 30, 45, 60), (0.03, 0.05, 0.08)
TIPS, CONTRASTS = ("blunt", "bevel"), (12, 20, 30)
RADIUS = 0.635e-3
MIRROR_DB = 20.0
"""Level of the mirror-like part over the rough surface's."""
DOWN = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, -0.1], [0, 0, 0, 1.0]])
"""Pose of the probe in the tissue; it looks down."""


@cache
def scanner():
    """Probe with the settings of fig. 5 and few frames, and its beam."""
    transducer, imaging = load_transducer("4dc7_3_40"), ImagingParameters(frames=11)
    geometry = sweep_geometry(transducer, imaging)
    beam = beam_profile(transducer, imaging, geometry)
    depths = geometry.sample_pitch * np.arange(geometry.samples)
    reference = int(np.abs(depths - transducer.lens_focus).argmin())
    bright = 20 * np.log10(projection_rays(geometry, beam, 1, 0, reference).bright)
    return SimpleNamespace(
        transducer=transducer, imaging=imaging, geometry=geometry, beam=beam, depths=depths,
        spread=point_spread(beam, geometry), bright=bright, width=beam.lateral[reference],
        conversion=ScanConversion(geometry, make_grid(geometry, [0.7e-3] * 3)),
    )  # fmt: skip


@dataclass(frozen=True)
class End:
    """Dip in deg, depth of the tip in m, kind of tip, and contrast of the rough shaft in dB."""

    dip: float
    depth: float
    tip: str
    contrast: float


def _levels(end, using, p, k):
    """Echo of a needle with the contrast wanted on its axis, and what its levels depend on."""
    covariance = blur_covariance(using.spread, using.geometry, p[np.newaxis])[0]
    blur = 1 / np.sqrt(k @ np.linalg.solve(covariance, k))
    bright = float(np.interp(p[1], using.depths, using.bright))
    level = end.contrast + MIRROR_DB - bright - 10 * np.log10(blur / using.width)
    echo = NeedleEchoParameters(
        specular_db=level, diffuse_db=-MIRROR_DB, diffuse_lobe_deg=None, tip=end.tip
    )
    return echo, blur, bright


def _needle(p, k, length):
    shaft = np.array([p - length * k, p]) @ DOWN[:3, :3].T + DOWN[:3, 3]
    return Needle(shaft, RADIUS)


def end_of(end, using):
    """Return the levels of a needle's end as the bound needs them."""
    dip, p = np.deg2rad(end.dip), np.array([0, end.depth, 0])
    k = np.array([np.cos(dip), np.sin(dip), 0])
    echo, blur, bright = _levels(end, using, p, k)
    return NeedleEnd(
        shaft_db=end.contrast,
        mirror_db=echo.specular_db + bright + 20 * np.log10(blur / using.width),
        reverberation_db=echo.reverberation_db,
        reverberation_distance=reverberations(echo, RADIUS, using.geometry.sound_speed)[1],
        wavelength=using.beam.wavelength,
        # Seen from its face, a bevel is as wide as the needle over most of its length.
        bevel_length=0.25 * echo.bevel_length * RADIUS,
    )


def sweep_with(end, using, seed):
    """Render a sweep; return it with the needle's (2, 3) ends in P and a generator."""
    rng = np.random.default_rng([seed, int(end.dip), int(1e3 * end.depth)])
    dip, azimuth = np.deg2rad([end.dip, rng.uniform(-5, 5)])
    k = np.array([np.cos(dip) * np.cos(azimuth), np.sin(dip), np.cos(dip) * np.sin(azimuth)])
    p = np.array([0, end.depth, 0]) + rng.uniform(-2e-3, 2e-3, 3)
    length = min(0.08, (p[1] + 0.05) / max(np.sin(dip), 1e-3))
    renderer = SweepRenderer(
        transducer=using.transducer,
        imaging=using.imaging,
        tissue=Tissue(size=[0.6, 0.6, 0.4], seed=seed),
        parameters=replace(CLEAN, needle=_levels(end, using, p, k)[0]),
        seed=seed,
    )
    frames = using.geometry.frames
    still = np.repeat(DOWN[np.newaxis], frames, axis=0)
    grey = renderer.render(still, [_needle(p, k, length)] * frames, 1, seed)
    motion = SweepMotion.at_rest(using.geometry, RigidTransform(), 0.0)
    sweep = Sweep(grey, motion, using.imaging.decibels_per_level, using.spread)
    return sweep, np.array([p - length * k, p]), rng
