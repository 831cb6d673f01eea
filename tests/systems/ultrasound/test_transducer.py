import dataclasses

import numpy as np
import pytest

from sonoservo.diagrams.papers.zhao2012.phantom import IMAGING as ZHAO
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.ultrasound import (
    ImagingParameters,
    Transducer,
    load_transducer,
    sweep_geometry,
)
from sonoservo.systems.ultrasound.transducer import assumed_fields


def test_shipped_transducers_load():
    assert load_transducer("4dc7_3_40") == Transducer()
    zhao = load_transducer("zhao2012")
    assert (zhao.lines - 1) * zhao.line_pitch_deg == pytest.approx(40, abs=1e-3)
    assert load_transducer("trus").array_radius == pytest.approx(0.010)
    assert not any(map(assumed_fields, ("4dc7_3_40", "4dl14_5_38", "matrix", "trus", "zhao2012")))
    with pytest.raises(FileNotFoundError, match=r"4dc7_3_40.*zhao2012"):
        load_transducer("5dc8")


def test_own_file(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("transducer: {array_radius: 0.06}\n")
    assert load_transducer(str(path)) == dataclasses.replace(Transducer(), array_radius=0.06)
    assert len(assumed_fields(str(path))) == len(dataclasses.fields(Transducer)) - 1
    assert "array_radius" not in assumed_fields(str(path))
    path.write_text("transducer: {lens_focus: -1}\n")
    with pytest.raises(ConfigurationError, match=r"mine\.yaml: transducer: lens_focus"):
        load_transducer(str(path))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("line_pitch_deg", 2.0),
        ("element_width", 0.5e-3),  # wider than the pitch
        ("lens_focus", 0.005),  # inside the element
        ("array_radius", 40.0),  # mm
    ],
)
def test_transducer_errors_name_the_field(name, value):
    with pytest.raises(ValueError, match=f"^{name}: {value}"):
        Transducer(**{name: value})


@pytest.mark.parametrize(("rate", "frames"), [(3.3, 27), (5.7, 15)])
def test_chatelain_2013_volume_rates(rate, frames):
    """Fig. 5's 3.3 and fig. 4's 5.7 volumes a second, with the settings of Table I."""
    geometry = sweep_geometry(Transducer(), ImagingParameters(volume_rate=rate))
    assert geometry.shape == (frames, 96, 293)
    assert geometry.period == pytest.approx(1 / rate)
    assert np.rad2deg(geometry.frame_pitch) == pytest.approx(1.463)
    assert geometry.depth == pytest.approx(0.09, abs=0.308e-3)


@pytest.mark.parametrize(
    ("name", "imaging"),
    [
        ("4dc7_3_40", ImagingParameters()),
        ("zhao2012", ZHAO),
        ("trus", ImagingParameters(depth=0.06, transmit_frequency=6.5e6, frame_pitch_deg=0.01)),
    ],
)
def test_sound_returns_from_every_line_before_the_next(name, imaging):
    """Lines, frames and sweeps follow without a gap, and none is shorter than the sound's way."""
    geometry = sweep_geometry(load_transducer(name), imaging)
    line_time = geometry.frame_period / geometry.lines
    assert line_time >= 2 * geometry.depth / imaging.sound_speed
    assert geometry.frames * geometry.frame_period == pytest.approx(1 / imaging.volume_rate)
    assert geometry.period == pytest.approx(1 / imaging.volume_rate)


@pytest.mark.parametrize(
    ("imaging", "message"),
    [
        ({"frames": 33, "volume_rate": 0.5}, "frames: 33 .* at most 31"),
        ({"volume_rate": 60}, "volume_rate: 60"),
        ({"frames": 31}, "frame_period: .* 96 lines"),
        ({"transmit_frequency": 10e6}, "transmit_frequency: 10 MHz .* from 3 to 7 MHz .* as 7e6"),
    ],
)
def test_what_sound_motor_and_elements_do_not_allow_is_named(imaging, message):
    assert sweep_geometry(Transducer(), ImagingParameters(volume_rate=0.5)).frames == 31
    with pytest.raises(ValueError, match=message):
        sweep_geometry(Transducer(), ImagingParameters(**imaging))


def test_lines_of_a_linear_probe_are_parallel_and_cover_its_face():
    imaging = ImagingParameters(
        transmit_frequency=7.5e6, focus_depth=0.03, depth=0.045, sector=1.0, sample_pitch=0.1e-3,
        frames=1, frame_pitch_deg=0.01, volume_rate=20.0,
    )  # fmt: skip
    geometry = sweep_geometry(load_transducer("4dl14_5_38"), imaging)
    ends = geometry.position(0, np.array([0, geometry.lines - 1])[:, np.newaxis], [0, 450], 1)
    width = ends[1, :, 0] - ends[0, :, 0]
    assert width[0] == pytest.approx(38.6e-3, rel=0.02)
    assert width[1] == pytest.approx(width[0], rel=0.011)
    assert np.abs(ends[..., 1] - [0, 0.045]).max() < 0.06e-3


def test_zhao_2012_volume():
    """Table 1 and its text: 53 x 71 lines of 2608 samples at 27 MHz, 40 deg each way."""
    geometry = sweep_geometry(load_transducer("zhao2012"), ZHAO)
    assert geometry.shape == (53, 71, 2608)
    assert 1540 / (2 * geometry.sample_pitch) == pytest.approx(27e6, rel=1e-3)
    assert np.rad2deg(52 * geometry.frame_pitch) == pytest.approx(39.25, abs=0.01)
