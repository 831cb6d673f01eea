import numpy as np
import pytest
from scipy.special import i0

from sonoservo.systems.signals import PointSpread, SweepGeometry
from sonoservo.systems.signals.point_spread import FWHM_PER_SIGMA
from tip_study.bound import envelope_log_likelihood, field_log_likelihood
from tip_study.needle_end import EchoModel, EndSamples, NeedleEnd, echo_model, samples_near

GEOMETRY = SweepGeometry(
    array_radius=0.04, motor_radius=0.027, line_pitch=0.0106, frame_pitch=0.0255,
    sample_pitch=0.4e-3, lines=96, frames=11, samples=226, frame_period=0.03,
)  # fmt: skip
SPREAD = PointSpread(np.array([0.0]), *(np.array([width]) for width in (2.4e-3, 1.9e-3, 0.42e-3)))


def line(spacing=1.0, reach=8.0, rings=((0.0, 0.0),)):
    """Samples on the axis and on lines beside it, in units of the blur."""
    along = np.arange(-reach, reach + 1e-9, spacing)
    return EndSamples(1e-3, np.repeat(along, len(rings)), np.tile(rings, (len(along), 1)))


def drawn(model, tip, rng):
    noise = rng.normal(scale=np.sqrt(0.5), size=(2, model.mean.shape[1]))
    return model.mean[tip] + model.root[tip] @ (noise[0] + 1j * noise[1])


def test_phases_are_integrated_out():
    rng = np.random.default_rng(1)
    model = echo_model(NeedleEnd(shaft_db=10, mirror_db=8), line(1.0, 1.0), np.zeros(1), -20.0)
    r = np.abs(drawn(model, 0, rng))
    inverse = np.linalg.inv(model.root[0] @ model.root[0].conj().T)
    phases = np.stack(np.meshgrid(*3 * [np.arange(24) / 24 * 2 * np.pi]), axis=-1).reshape(-1, 3)
    away = r * np.exp(1j * phases) - model.mean[0]
    density = np.exp(-np.einsum("pi,ij,pj->p", away.conj(), inverse, away).real)
    expected = np.prod(2 * r) * density.mean() * np.linalg.det(inverse)
    found = envelope_log_likelihood(model, r, rng, particles=20000)[0]
    assert found == pytest.approx(np.log(expected), abs=0.03)
    # The mean's own phase does not matter to a field of unknown phase.
    turned = EchoModel(model.mean * 1j, model.root)
    for each in (model, turned):
        assert field_log_likelihood(each, away[0])[0] == pytest.approx(
            field_log_likelihood(model, away[0])[0]
        )


def test_a_pair_of_fields_without_a_mean_has_the_closed_form():
    covariance = np.array([[3.0, 1.2], [1.2, 2.0]])
    r = np.array([1.3, 0.9])
    found = envelope_log_likelihood(
        EchoModel(np.zeros((1, 2), complex), np.linalg.cholesky(covariance)[np.newaxis]), r,
        np.random.default_rng(0), particles=1000,
    )[0]  # fmt: skip
    inverse = np.linalg.inv(covariance)
    expected = 4 * np.prod(r) * np.linalg.det(inverse) * i0(2 * abs(inverse[0, 1]) * np.prod(r))
    expected *= np.exp(-(r**2 @ np.diag(inverse)))
    assert found == pytest.approx(np.log(expected), abs=1e-2)


def test_the_blur_on_the_axis_is_the_unit_of_length():
    k = np.array([np.cos(0.5), np.sin(0.5), 0.0])
    places = [np.array([0, 0.05, z]) for z in np.linspace(0, 0.077 * 0.0255, 8)]
    found = [samples_near(GEOMETRY, SPREAD, place, k) for place in places]
    lateral, axial = 2.4e-3 / FWHM_PER_SIGMA, 0.42e-3 / FWHM_PER_SIGMA
    assert found[0].blur == pytest.approx(1 / np.hypot(k[0] / lateral, k[1] / axial))
    assert np.all(np.diff(found[0].along) >= 0)
    # As many as the cylinder has room for.
    cell = 0.09 * 0.0106 * 0.077 * 0.0255 * 0.4e-3
    unit = lateral * axial * 1.9e-3 / FWHM_PER_SIGMA
    count = np.mean([len(each.along) for each in found])
    assert count == pytest.approx(16 * np.pi * 2**2 * unit / cell, rel=0.15)
