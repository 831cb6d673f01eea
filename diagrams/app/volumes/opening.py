"""Opening of recorded and live volumes, as the options of a command say."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

from sonoservo.diagrams.app.options import Reading, ReadingFrames
from sonoservo.diagrams.app.volumes.reconstruct import ReconstructedRecording
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.live.connection.address import Address
from sonoservo.systems.live.frames_to_volumes import FramesToVolumes
from sonoservo.systems.live.live_source import LiveSource
from sonoservo.systems.live.motor_sweep import MotorSweepVolumes, load_motor_sweep
from sonoservo.systems.live.volume_maker import ImagesToVolumes, VolumeMaker
from sonoservo.systems.recording.plus_configuration import (
    PlusConfiguration,
    read_calibration,
    read_plus_configuration,
)
from sonoservo.systems.recording.recording import Recording

Opened: TypeAlias = Recording | ReconstructedRecording


def with_frames(reading: Reading, **frames: Any) -> ReadingFrames:
    """Return how volumes are read with what is wanted of 2D frames."""
    return ReadingFrames(**{**vars(reading), **frames})


def open_volumes(path: Path, reading: Reading | None = None) -> Opened:
    """Open a file of volumes, or of frames to be reconstructed; errors name the file and fault."""
    options = with_frames(reading or Reading())
    known = PlusConfiguration()
    if options.plus_config is not None:
        known = read_plus_configuration(options.plus_config)
    transforms = known.matrices
    if options.calibration is not None:  # which counts before the configuration's
        name, matrix = read_calibration(options.calibration)
        transforms[name] = matrix
    common: dict[str, Any] = {
        name: getattr(options, name)
        for name in ("poses", "window", "dynamic_range_db", "void", "luminance")
    } | {"transforms": transforms, "orientation": known.orientation}
    opened: Opened
    if options.reconstruct:
        opened = ReconstructedRecording(
            path,
            frames=options.frames,
            spacing=options.spacing,
            frame_rate=options.volume_rate,
            clip=known.clip,
            **common,
        )
    else:
        opened = Recording(path, depth=options.depth, volume_rate=options.volume_rate, **common)
    opened.notes[:0] = known.notes()
    return opened


@contextmanager
def live_source(
    place: Address, reading: ReadingFrames, say: Callable[[str], None], keep: int = 1
) -> Iterator[LiveSource]:
    """Open the source of live volumes at an address; see `LiveSource` for ``keep``."""
    with LiveSource(
        place,
        maker=live_maker(reading),
        poses=reading.poses,
        keep=keep,
        clock_offset=reading.clock_offset,
        report=say,
    ) as source:
        if place.listens:
            say(f"Waiting for a scanner on port {source.link.port}; Ctrl-C ends")
        yield source


def live_maker(reading: ReadingFrames) -> ImagesToVolumes:
    """Return the converter of received images to volumes; a motor's file has its own range."""
    try:
        if reading.motor is not None:
            return MotorSweepVolumes(load_motor_sweep(reading.motor), window=reading.window)
        grey: dict[str, Any] = {
            "window": reading.window,
            "dynamic_range_db": reading.dynamic_range_db,
        }
        if reading.reconstruct:
            return FramesToVolumes(frames=reading.frames, spacing=reading.spacing, **grey)
        return VolumeMaker(depth=reading.depth, **grey)
    except ValueError as error:
        raise ConfigurationError(str(error)) from error
