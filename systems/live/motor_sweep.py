"""From the received frames of a motorised probe to volumes, by what is known about its motor."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.typed_yaml import load_typed, read_yaml
from sonoservo.systems.live.frames_to_volumes import frame_levels
from sonoservo.systems.live.image_matcher import PosedImage
from sonoservo.systems.live.volume_maker import ImagesToVolumes
from sonoservo.systems.signals.immutable import NotFound, seal
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.sweep import Sweep, SweepMotion
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.ultrasound.beam import beam_profile, point_spread
from sonoservo.systems.ultrasound.frame_reconstruction import PosedFrame, reconstruct
from sonoservo.systems.ultrasound.imaging import ImagingParameters, sweep_geometry
from sonoservo.systems.ultrasound.scan_conversion import ScanConversion, make_grid
from sonoservo.systems.ultrasound.scan_converter import ScanConversionParameters
from sonoservo.systems.ultrasound.transducer import load_transducer


@dataclass(kw_only=True)
class MotorSweepParameters:
    """Sweep of a probe's array by its motor.

    Parameters
    ----------
    probe
        Name of a file in models/probes, or a path.
    imaging
        The scanner's settings; they say how many frames a sweep has, and how long each takes.
    scan_conversion
        Grid of the volumes.
    start
        Time at which a first sweep towards +Z began, in s.
    both_ways
        True if every other sweep goes towards -Z; otherwise the motor flies back in no time.
    """

    probe: str = "4dc7_3_40"
    imaging: ImagingParameters = field(default_factory=ImagingParameters)
    scan_conversion: ScanConversionParameters = field(default_factory=ScanConversionParameters)
    start: float = 0.0
    both_ways: bool = True

    def __post_init__(self) -> None:
        require(bool(np.isfinite(self.start)), "start", self.start, "a time in s")


def load_motor_sweep(path: Path) -> MotorSweepParameters:
    """Read how a motor sweeps from a YAML file; a ConfigurationError names a wrong field."""
    return load_typed(MotorSweepParameters, read_yaml(path), str(path))


class MotorSweepVolumes(ImagesToVolumes):
    """Makes a volume of every sweep of a motorised probe.

    A frame's time tells its place in the sweep. Frames of (samples, lines) numbers are converted as
    the simulated scanner's are; others are pictures, placed by the motor's angle: their first row
    lies on the face, their first axis along the array. ValueError if a parameter, or the window
    (`GreyLevels`), is not allowed.
    """

    takes_frames = True

    def __init__(
        self, parameters: MotorSweepParameters, *, window: tuple[float, float] | None = None
    ) -> None:
        super().__init__(window)
        self._start, self._both_ways = parameters.start, parameters.both_ways
        transducer = load_transducer(parameters.probe)
        self.geometry = sweep_geometry(transducer, parameters.imaging)
        beam = beam_profile(transducer, parameters.imaging, self.geometry)
        self._spread = point_spread(beam, self.geometry)
        self._scale = parameters.imaging.decibels_per_level
        spacing = parameters.scan_conversion.spacing
        self._spacing = min(spacing)
        self._conversion = ScanConversion(
            self.geometry,
            make_grid(self.geometry, spacing),
            compensate_motion=parameters.scan_conversion.compensate_motion,
        )
        self._number = -1
        self._frames: dict[int, PosedImage] = {}

    def _make(self, posed: PosedImage) -> Volume | NotFound:
        geometry = self.geometry
        count = round((posed.time - self._start) / geometry.frame_period)
        number, at = divmod(count, geometry.frames)
        missing = 0
        if number != self._number:
            missing = geometry.frames - len(self._frames) if self._frames else 0
            self._number, self._frames = number, {}
        self._frames[at] = posed
        if len(self._frames) < geometry.frames:
            return NotFound(f"a sweep lacks {missing} frames" if missing else "")
        direction = -1 if self._both_ways and number % 2 else 1
        frames = [self._frames[k] for k in range(geometry.frames)][::direction]
        self._frames = {}
        return self._volume(frames, direction)

    def _volume(self, frames: list[PosedImage], direction: int) -> Volume:
        geometry = self.geometry
        pixels = [frame_levels(frame, self.grey) for frame in frames]
        if {each.shape for each in pixels} == {(geometry.samples, geometry.lines)}:
            samples = np.array([np.rint(each).astype(np.uint8).T for each in pixels])
            poses = np.array([frame.X_WL.GetAsMatrix4() for frame in frames])
            times = np.array([frame.time for frame in frames])
            motion = SweepMotion(geometry, direction, times, poses)
            return self._conversion(Sweep(seal(samples), motion, self._scale, self._spread))
        angles = geometry.line_angles(direction).mean(axis=1)
        pictures = [
            PosedFrame(
                each,
                frame.X_WL.GetAsMatrix4() @ self._turned(float(angle)) @ frame.image.X_LI,
                frame.time,
            )
            for each, frame, angle in zip(pixels, frames, angles, strict=True)
        ]
        return reconstruct(
            pictures[::direction], spacing=self._spacing, decibels_per_level=self._scale
        )

    def _turned(self, angle: float) -> NDArray[np.float64]:
        """Return (4, 4) from the plane Z = 0 of P to the frame's plane at a motor angle in rad."""
        turn = np.eye(4)
        turn[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        to_axis = np.eye(4)
        to_axis[1, 3] = self.geometry.motor_radius
        return np.linalg.inv(to_axis) @ turn @ to_axis
