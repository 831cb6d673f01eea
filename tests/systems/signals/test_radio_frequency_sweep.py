"""Radio-frequency sweeps: where their samples lie, and their envelope."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.signals.radio_frequency_sweep import RadioFrequencySweep
from sonoservo.systems.signals.sweep import SweepGeometry, SweepMotion
from sonoservo.systems.ultrasound.radio_frequency import detect_envelope

GEOMETRY = SweepGeometry(0.0, 0.0, 0.01, 0.013, 2.8519e-5, 15, 7, 1001, 0.01)
X_WP = RigidTransform(RotationMatrix.MakeXRotation(0.3), [0.1, 0.2, 0.3])
POSES = np.repeat(X_WP.GetAsMatrix4()[np.newaxis], GEOMETRY.frames, axis=0)
MOTION = SweepMotion(GEOMETRY, 1, np.linspace(0, 0.06, GEOMETRY.frames), POSES)


def sweep_of(line):
    lines = np.zeros(GEOMETRY.shape, np.float32)
    lines[:] = line
    return RadioFrequencySweep(lines, MOTION)


@given(k=st.floats(0, 6), j=st.floats(0, 14), i=st.floats(50, 1000))
def test_index_is_the_inverse_of_position(k, j, i):
    sweep = sweep_of(0.0)
    index = np.array([[k, j, i]])
    np.testing.assert_allclose(sweep.index(sweep.position(index)), index, atol=1e-6)
    p_P = sweep.position(index)
    p_W, times = sweep.to_world(p_P)
    np.testing.assert_allclose(sweep.to_probe(p_W), p_P, atol=1e-12)
    assert times[0] == pytest.approx(0.01 * k)


@pytest.mark.parametrize("amplitude_db", [-10.0, 20.0])
def test_envelope_of_a_carrier_is_its_amplitude_but_for_a_decibel(amplitude_db):
    # 7.5 MHz at 27 MHz: 3.6 samples a period, of which five samples see more than one.
    i = np.arange(GEOMETRY.samples)
    line = 10 ** (amplitude_db / 20) * np.cos(2 * np.pi * i / 3.6 + 0.4)
    grey = detect_envelope(sweep_of(line), step=4, floor_db=-20.0).samples
    decibels = grey.astype(float) * 60 / 255 - 20
    assert decibels.max() <= amplitude_db + 0.2
    assert decibels.min() >= amplitude_db - 1.2


def test_an_echo_stays_where_it_is():
    line = np.zeros(GEOMETRY.samples)
    line[400] = 1.0
    sweep = sweep_of(line)
    detected = detect_envelope(sweep, step=4, floor_db=-20.0)
    assert detected.samples[3, 7].argmax() == 100
    assert np.count_nonzero(detected.samples[3, 7]) == 1
    np.testing.assert_allclose(
        detected.geometry.position(3, 7, 100, 1), sweep.position([3, 7, 400]), atol=1e-12
    )
    assert detected.geometry.depth == pytest.approx(GEOMETRY.depth)


def test_depths_of_no_interest_are_not_looked_at():
    detected = detect_envelope(sweep_of(1.0), step=4, floor_db=-20.0, near=0.01, far=0.02)
    depths = detected.geometry.sample_pitch * np.arange(detected.geometry.samples)
    seen = detected.samples.any(axis=(0, 1))
    assert depths[seen].min() == pytest.approx(0.01, abs=2e-4)
    assert depths[seen].max() == pytest.approx(0.02, abs=2e-4)
    assert seen.sum() == pytest.approx(0.01 / detected.geometry.sample_pitch, abs=2)


def test_bad_input_is_refused():
    with pytest.raises(ValueError, match="lines.shape"):
        RadioFrequencySweep(np.zeros((2, 3, 4), np.float32), MOTION)
    with pytest.raises(ValueError, match="step"):
        detect_envelope(sweep_of(0.0), step=0, floor_db=-20.0)
