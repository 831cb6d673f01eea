import dataclasses

import numpy as np
import pytest

from sonoservo.systems.typed_yaml import ConfigurationError
from sonoservo.systems.ultrasound.imaging import ImagingParameters, sweep_geometry
from sonoservo.systems.ultrasound.transducer import Transducer, load_transducer


def test_shipped_transducers_load():
    assert load_transducer("4dc7_3_40") == Transducer()
    zhao = load_transducer("zhao2012")
    assert (zhao.lines - 1) * zhao.line_pitch_deg == pytest.approx(40, abs=1e-3)
    assert load_transducer("trus").array_radius == pytest.approx(0.010)


def test_unknown_transducer_lists_those_that_ship():
    with pytest.raises(FileNotFoundError, match=r"4dc7_3_40.*zhao2012"):
        load_transducer("5dc8")


def test_own_file(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("array_radius: 0.06\n")
    assert load_transducer(str(path)) == dataclasses.replace(Transducer(), array_radius=0.06)
    path.write_text("lens_focus: -1\n")
    with pytest.raises(ConfigurationError, match="lens_focus"):
        load_transducer(str(path))


@pytest.mark.parametrize(
    ("name", "value"),
    [("lines", 1), ("element_height", 0.0), ("line_pitch_deg", 2.0), ("side_lobe_level", -30.0)],
)
def test_transducer_errors_name_the_field(name, value):
    with pytest.raises(ValueError, match=name):
        Transducer(**{name: value})


@pytest.mark.parametrize(("rate", "frames"), [(3.3, 27), (5.7, 15)])
def test_chatelain_2013_volume_rates(rate, frames):
    """Fig. 5's 3.3 and fig. 4's 5.7 volumes a second, with the settings of Table I."""
    geometry = sweep_geometry(Transducer(), ImagingParameters(volume_rate=rate))
    assert geometry.shape == (frames, 96, 293)
    assert geometry.period == pytest.approx(1 / rate)
    assert np.rad2deg(geometry.frame_pitch) == pytest.approx(1.463)
    assert geometry.depth == pytest.approx(0.09, abs=0.308e-3)


def test_motor_limits_the_frames():
    geometry = sweep_geometry(Transducer(), ImagingParameters(volume_rate=0.5))
    assert geometry.frames == 31
    with pytest.raises(ValueError, match=r"frames: 33 .* at most 31"):
        sweep_geometry(Transducer(), ImagingParameters(frames=33, volume_rate=0.5))


def test_sound_needs_time():
    with pytest.raises(ValueError, match=r"volume_rate: 60"):
        sweep_geometry(Transducer(), ImagingParameters(volume_rate=60))
    with pytest.raises(ValueError, match=r"frame_period: .* 96 lines"):
        sweep_geometry(Transducer(), ImagingParameters(frames=31))


def test_frequency_must_suit_the_transducer():
    with pytest.raises(ValueError, match="transmit_frequency"):
        sweep_geometry(Transducer(), ImagingParameters(transmit_frequency=10e6))


@pytest.mark.parametrize(("name", "value"), [("gain", 1.2), ("sector", 0.0), ("depth", 0.0)])
def test_imaging_errors_name_the_field(name, value):
    with pytest.raises(ValueError, match=name):
        ImagingParameters(**{name: value})
