"""Hardware of a motorised ultrasound probe."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from sonoservo.systems.files.model_file import model_file, read_once, read_section
from sonoservo.systems.files.typed_yaml import load_typed
from sonoservo.systems.signals.requirements import (
    Bound,
    Positive,
    at_least,
    check_bounds,
    require,
    within,
)

Count: TypeAlias = Annotated[int, at_least(2)]


def _length(high: float) -> Bound:
    """Return the bound of a length that is above zero and has a greatest value, in m."""
    return Bound(
        f"above 0 and at most {high:g} m; lengths are in m", lambda value: 0 < value <= high
    )


@dataclass(kw_only=True)
class Transducer:
    """Hardware of a motorised probe: an arc of elements under a lens, turned by a motor.

    The defaults are those of the Ultrasonix 4DC7-3/40; `load_transducer` reads other probes.

    Parameters
    ----------
    array_radius, motor_radius
        Distances from the face to the array's centre of curvature and to the motor's axis, in m. An
        array radius of zero makes the array flat, with the sector's apex in the middle of the face.
        One of some metres makes a linear array, with lines that are all but parallel.
    lines
        Number of scan lines of the full sector.
    line_pitch_deg
        Angle between neighbouring lines, in deg.
    most_frames
        Maximum number of frames in a sweep.
    elements, element_pitch
        Number of elements, and distance between their centres along the face, in m.
    element_width
        Width of an element along the face, in m.
    element_height
        Height of the elements in elevation, in m.
    lens_focus
        Depth at which the lens focuses in elevation, in m.
    lowest_frequency, highest_frequency
        Limits of the transmit frequency, in Hz.
    fractional_bandwidth
        Width of the two-way spectrum at -6 dB, as a fraction of the transmit frequency.
    transmit_elements, receive_elements
        Maximum number of elements that transmit, and that receive, at the same time.
    transmit_f_number, receive_f_number
        Ratio of depth to aperture width. The receiving aperture grows with depth and is weighted by
        a Hann window; its focus follows the depth.
    side_lobe_level
        Amplitude of a needle's echo through the beam's side lobes, relative to that through the
        main lobe (0.0316 is -30 dB); 0 for none, also in elevation, where the level is that of one
        row of elements. Side lobes are rendered for bright objects only: those of the tissue would
        fill what is black up to -20 dB.

    Raises
    ------
    ValueError
        If a value is out of range; the message names it.
    """

    array_radius: Annotated[float, within(0, 10, " m; lengths are in m")] = 0.040
    motor_radius: Annotated[float, within(0, 0.5, " m; lengths are in m")] = 0.02725
    lines: Count = 128
    line_pitch_deg: Positive = 0.608768
    most_frames: Count = 31
    elements: Count = 128
    element_pitch: Annotated[float, _length(0.01)] = 0.425e-3
    element_width: Positive = 0.375e-3
    element_height: Annotated[float, _length(0.1)] = 0.012
    lens_focus: Annotated[float, _length(1.0)] = 0.060
    lowest_frequency: Annotated[float, at_least(1e5, " Hz; frequencies are in Hz")] = 3.0e6
    highest_frequency: float = 7.0e6
    fractional_bandwidth: Positive = 0.7
    transmit_elements: Count = 48
    receive_elements: Count = 64
    transmit_f_number: Positive = 2.0
    receive_f_number: Positive = 2.0
    side_lobe_level: Annotated[float, Bound("from 0, below 1", lambda level: 0 <= level < 1)] = (
        0.0316
    )

    def __post_init__(self) -> None:
        check_bounds(self)
        half, most = self.element_height / 2, 150 / self.lines
        for name, fits, allowed in (
            ("element_width", self.element_width <= self.element_pitch, "at most element_pitch"),
            ("lens_focus", self.lens_focus >= half, "at least half of element_height"),
            (
                "line_pitch_deg",
                self.lines * self.line_pitch_deg <= 150,
                f"at most {most:g} deg for {self.lines} lines: a sector of 150 deg",
            ),
            (
                "highest_frequency",
                self.highest_frequency >= self.lowest_frequency,
                "at least lowest_frequency",
            ),
        ):
            require(fits, name, getattr(self, name), allowed)


def load_transducer(name: str) -> Transducer:
    """Read the transducer of a probe from YAML.

    Parameters
    ----------
    name
        Name of a file in ``models/probes`` ("4dc7_3_40", "zhao2012", "trus"), or a path.
    """
    return _read_transducer(model_file("probes", name))


def assumed_fields(name: str) -> list[str]:
    """Return the fields that a probe's file leaves out: they are those of the 4DC7-3/40."""
    content = _section(model_file("probes", name))
    return [each.name for each in fields(Transducer) if each.name not in content]


@read_once
def _read_transducer(path: Path) -> Transducer:
    return load_typed(Transducer, _section(path), f"{path}: transducer")


def _section(path: Path) -> dict[str, Any]:
    return read_section(path, "transducer", ("transducer", "body"))
