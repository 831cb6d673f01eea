"""Clutter and gain errors: statistics, width, and that they belong to the probe."""

import dataclasses

import numpy as np
import pytest
from renderers import CLEAN, NOWHERE, still

from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation.haze import gain_errors, speckle_field
from sonoservo.systems.ultrasound.simulation.rendering import SweepRenderer
from sonoservo.systems.ultrasound.simulation.tissue import Tissue
from sonoservo.systems.ultrasound.transducer import Transducer

NOTHING = Tissue(size=[0.6, 0.6, 0.4], level_db=-60.0)


def make(tissue=NOTHING, **parameters):
    parameters = dataclasses.replace(CLEAN, gel_thickness=1.0, noise_db=-90.0, **parameters)
    return SweepRenderer(
        transducer=Transducer(), imaging=ImagingParameters(gain=0.8), tissue=tissue,
        parameters=parameters, seed=0,
    )  # fmt: skip


def levels_db(renderer, X=None):
    """Levels over the tissue's in dB; black is as dark as the noise allows."""
    poses = still(renderer) if X is None else X
    grey = renderer.render(poses, [NOWHERE] * renderer.geometry.frames, 1, 0).astype(float)
    return (grey - ImagingParameters(gain=0.8).tissue_grey) * renderer.decibels_per_level


def test_the_field_is_speckle_of_the_beams_width():
    renderer = make()
    field = speckle_field(renderer.geometry, renderer.beam, np.random.default_rng(0))
    power = np.abs(field) ** 2
    assert power.mean() == pytest.approx(1, abs=0.01)
    assert (power**2).mean() == pytest.approx(2, abs=0.15)  # fully developed
    step = renderer.geometry.sample_pitch / renderer.beam.axial
    along = np.vdot(field[..., :-1], field[..., 1:]).real / np.vdot(field, field).real
    # Coarse samples of the filter make it a little narrower than the pulse.
    assert along == pytest.approx(np.exp(-(step**2) / 4), abs=0.1)
    third = np.roll(field, 32, axis=1)
    assert abs(np.vdot(field, third)) / np.vdot(field, field).real < 0.05


def test_clutter_fades_with_depth_and_stays_with_the_probe():
    renderer = make(clutter_db=-10.0, clutter_length=0.03)
    clutter = levels_db(renderer)
    expected = -10 - 20 * np.log10(np.e) * 0.03 / 0.03 - 2.51  # mean of a Rayleigh level in dB
    at = round(0.03 / renderer.geometry.sample_pitch)
    assert clutter[..., at - 5 : at + 6].mean() == pytest.approx(expected, abs=0.7)
    aside = still(renderer)
    aside[:, 0, 3] += 0.01
    assert np.corrcoef(clutter.ravel(), levels_db(renderer, aside).ravel())[0, 1] > 0.99


def test_gain_errors_have_their_size_and_are_what_the_image_shows():
    draws = np.array([gain_errors(2.0, 293, np.random.default_rng(seed)) for seed in range(400)])
    assert draws[:, 0].std() == pytest.approx(2, rel=0.1)
    clean, wrong = (
        levels_db(make(Tissue(size=[0.6, 0.6, 0.4]), gain_error_db=error)) for error in (0.0, 2.0)
    )
    shift = np.median(wrong - clean, axis=(0, 1))
    assert np.std(shift) > 0.5
    assert np.abs(np.diff(shift)).max() < 0.4
