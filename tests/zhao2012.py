"""The scanner's settings of Zhao, Liebgott and Cachard 2012, Table 1."""

from sonoservo.systems.ultrasound.imaging import ImagingParameters

ZHAO = ImagingParameters(
    depth=0.07435,
    sector=1.0,
    transmit_frequency=7.5e6,
    focus_depth=0.05,
    frame_pitch_deg=0.7547,
    volume_rate=1.0,
    frames=53,
    sample_pitch=2.8519e-5,
)
