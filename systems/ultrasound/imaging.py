"""Settings of an ultrasound scanner."""

import math
from dataclasses import dataclass
from typing import Annotated

from sonoservo.systems.signals.requirements import (
    Bound,
    Fraction,
    Positive,
    check_bounds,
    require,
    within,
)
from sonoservo.systems.signals.sweep import DYNAMIC_RANGE_DB, SweepGeometry
from sonoservo.systems.ultrasound.transducer import Transducer

_MOST_SAMPLES = 20_000
"""Largest number of samples of a line; a line of 0.3 m sampled at 50 MHz has as many."""


@dataclass(kw_only=True)
class ImagingParameters:
    """Settings that a sonographer makes; the defaults follow Chatelain 2013, Table I and fig. 5.

    Parameters
    ----------
    gain
        Gain from 0 to 1, over 50 dB. At 0.42, tissue of mean echo intensity has the grey level of
        0.42 x 50 dB, which is 89 of 255 for a dynamic range of 60 dB.
    depth
        Distance from the face to the last sample, in m.
    sector
        Share of the transducer's lines that are used, above 0 and at most 1.
    transmit_frequency
        Transmit frequency, in Hz.
    focus_depth
        Depth of the transmitted beam's focus, in m.
    frame_pitch_deg
        Angle between neighbouring frames of the sweep ("degrees per frame"), in deg.
    volume_rate
        Sweeps per second, in Hz.
    frames
        Number of frames per sweep; None for the largest odd number that fits.
    sample_pitch
        Distance between the samples of a line, in m.
    dynamic_range_db
        Range of echo amplitudes that the grey levels 0 to 255 show, in dB.
    sound_speed
        Speed of sound, in m/s.

    Raises
    ------
    ValueError
        If a value is out of range; the message names it.
    """

    gain: Fraction = 0.42
    depth: Annotated[
        float, Bound("above 0 and at most 0.5 m; lengths are in m", lambda depth: 0 < depth <= 0.5)
    ] = 0.09
    sector: Annotated[float, Bound("above 0, at most 1", lambda share: 0 < share <= 1)] = 0.75
    transmit_frequency: Positive = 3.3e6
    focus_depth: Annotated[float, within(0.001, 1.0)] = 0.025
    frame_pitch_deg: Positive = 1.463
    volume_rate: Positive = 3.3
    frames: int | None = None
    sample_pitch: Positive = 0.308e-3
    dynamic_range_db: Annotated[float, within(*DYNAMIC_RANGE_DB)] = 60.0
    sound_speed: Positive = 1540.0

    def __post_init__(self) -> None:
        check_bounds(self)
        require(
            self.depth >= 4 * self.sample_pitch, "depth", self.depth, "at least 4 sample pitches"
        )
        finest = self.depth / _MOST_SAMPLES
        allowed = f"at least {finest:g} m, a {_MOST_SAMPLES}th of the depth"
        require(self.sample_pitch >= finest, "sample_pitch", self.sample_pitch, allowed)

    @property
    def wavelength(self) -> float:
        """Wavelength at the transmit frequency, in m."""
        return self.sound_speed / self.transmit_frequency

    @property
    def decibels_per_level(self) -> float:
        """Scale of the image, in dB per grey level."""
        return self.dynamic_range_db / 255

    @property
    def grey_per_db(self) -> float:
        """Grey levels per dB."""
        return 255 / self.dynamic_range_db

    @property
    def tissue_grey(self) -> float:
        """Grey level of the tissue's mean echo intensity."""
        return self.grey_per_db * 50 * self.gain


def sweep_geometry(transducer: Transducer, imaging: ImagingParameters) -> SweepGeometry:
    """Return the positions of a sweep's samples and the times of their acquisition.

    If the settings leave the number of frames open, it is the largest odd number for which the
    sound has time to travel: 27 at 3.3 volumes per second and 15 at 5.7, for 96 lines 9 cm deep.

    Raises
    ------
    ValueError
        If the sound has no time to travel, or the settings exceed the transducer's limits.
    """
    low, high = transducer.lowest_frequency, transducer.highest_frequency
    frequency = imaging.transmit_frequency
    if not low <= frequency <= high:
        given, lowest, highest = (f"{1e-6 * each:g}" for each in (frequency, low, high))
        raise ValueError(
            f"imaging.transmit_frequency: {given} MHz is not allowed; it must be from {lowest} to "
            f"{highest} MHz with this transducer, given in Hz, such as {highest}e6"
        )
    lines = max(round(imaging.sector * transducer.lines), 2)
    samples = math.floor(imaging.depth / imaging.sample_pitch * (1 + 1e-9)) + 1
    frames = imaging.frames
    if frames is None:
        line_time = 2 * (samples - 1) * imaging.sample_pitch / imaging.sound_speed
        fitting = math.floor(1 / imaging.volume_rate / (lines * line_time) * (1 + 1e-9))
        frames = min(fitting, transducer.most_frames)
        frames -= 1 - frames % 2
        require(
            frames >= 3,
            "imaging.volume_rate",
            imaging.volume_rate,
            f"lower: sound has time for {fitting} frames of {lines} lines in a sweep",
        )
    require(
        frames <= transducer.most_frames,
        "imaging.frames",
        frames,
        f"at most {transducer.most_frames} with this transducer",
    )
    return SweepGeometry(
        array_radius=transducer.array_radius,
        motor_radius=transducer.motor_radius,
        line_pitch=math.radians(transducer.line_pitch_deg),
        frame_pitch=math.radians(imaging.frame_pitch_deg),
        sample_pitch=imaging.sample_pitch,
        lines=lines,
        frames=frames,
        samples=samples,
        frame_period=1 / (imaging.volume_rate * frames),
        sound_speed=imaging.sound_speed,
    )
