"""Opening of recorded and live volumes, as the options of a command say."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.diagrams.app.options import Reading, ReadingFrames, refusing_values
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.volume_file import VolumeFile
from sonoservo.systems.live.connection.address import Address
from sonoservo.systems.live.frames_to_volumes import FramesToVolumes
from sonoservo.systems.live.live_source import LiveSource
from sonoservo.systems.live.motor_sweep import MotorSweepVolumes, load_motor_sweep
from sonoservo.systems.live.volume_maker import ImagesToVolumes, VolumeMaker, grey_scale
from sonoservo.systems.recording.plus_configuration import (
    PlusConfiguration,
    read_calibration,
    read_plus_configuration,
)
from sonoservo.systems.recording.recording import Recording
from sonoservo.systems.recording.tracked_frames import TrackedFrames
from sonoservo.systems.recording.valid_frames import Unusable
from sonoservo.systems.signals.volume import ReconstructedVolume
from sonoservo.systems.ultrasound.frame_reconstruction import (
    PosedFrame,
    SweepSplitter,
    reconstruct,
)


class ReconstructedRecording:
    """Volumes of a file of 2D frames, one for each sweep, with the interface of `Recording`.

    L and W are both the reference frame of the file's poses. A volume has so many ``frames``, or
    ends where the probe turns back; its spacing is in m. ``reading`` holds other arguments of
    `TrackedFrames`, whose errors it raises.
    """

    frame = "the frame of the poses"
    """Name of L."""

    def __init__(
        self,
        path: Path,
        *,
        poses: str | None = None,
        window: tuple[float, float] | None = None,
        dynamic_range_db: float | None = None,
        frames: int | None = None,
        spacing: float = 7e-4,
        frame_rate: float | None = None,
        **reading: Any,
    ) -> None:
        self.path = path
        self._spacing = spacing
        with refusing_values(path):
            self._scale = grey_scale(dynamic_range_db)
        self._frames = TrackedFrames(
            path, poses=poses, window=window, frame_rate=frame_rate, **reading
        )
        self._sweeps = self._split(frames)
        self.times = np.array([self._frames.times[s[len(s) // 2]] for s in self._sweeps])
        self.notes = list(self._frames.notes)
        if len(self._sweeps) == 1:
            self.notes.append(
                "its frames make a single sweep, and so one volume: `sonoservo locate` finds a "
                "needle in it, but tracking needs several sweeps"
            )
        self.posed = True
        self.settings: dict[str, Any] = {}
        self._read = lru_cache(maxsize=1)(self._reconstruct)

    @property
    def stated_times(self) -> NDArray[np.float64]:
        """(n,) times of all frames of the file, in s."""
        return self._frames.stated_times

    @property
    def file(self) -> VolumeFile:
        """The file as its header describes it."""
        return self._frames.file

    def __len__(self) -> int:
        return len(self._sweeps)

    def __iter__(self) -> Iterator[ReconstructedVolume]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, number: int) -> ReconstructedVolume:
        """Reconstruct a volume."""
        return self._read(range(len(self))[number])

    def X_WL(self, number: int) -> RigidTransform:
        """Return the pose of L in W, which is the identity."""
        return RigidTransform()

    @property
    def pixel_sizes(self) -> NDArray[np.float64]:
        """(2,) width and height of a pixel in mm, by the calibration."""
        return np.asarray(1e3 * np.linalg.norm(self._frames.X_WI[0][:3, :2], axis=0))

    @property
    def left_out(self) -> dict[Unusable, list[int]]:
        """Numbers of the frames left out by reason, with those so far that hold nothing."""
        void = {Unusable.EMPTY: sorted(self._frames.void)} if self._frames.void else {}
        return {**self._frames.left_out, **void}

    @property
    def skipped(self) -> int:
        """Number of frames left out, with those so far that hold nothing."""
        return sum(map(len, self.left_out.values()))

    def _split(self, count: int | None) -> list[list[int]]:
        """Return the numbers of each sweep's frames."""
        with refusing_values(self.path):
            splitter = SweepSplitter(frames=count, max_frames=len(self._frames))
        # The splitter needs only the number of pixels, not their values.
        pixels = self._frames[0]
        numbers = {time: k for k, time in enumerate(self._frames.times)}
        sweeps = []
        for X_WI, time in zip(self._frames.X_WI, self._frames.times, strict=True):
            sweeps.append(splitter.add(PosedFrame(pixels, X_WI, time)))
        sweeps.append(splitter.rest())
        found = [[numbers[frame.time] for frame in sweep] for sweep in sweeps if sweep]
        if not found:
            moved = 1e3 * np.linalg.norm(np.ptp(np.array(self._frames.X_WI)[:, :3, 3], axis=0))
            raise ConfigurationError(
                f"{self.path}: the probe moves over {moved:.2g} mm, too little for a volume; are "
                "positions in mm?"
            )
        return found

    def sweep(self, number: int) -> list[PosedFrame]:
        """Return the frames of a sweep, without those that hold nothing."""
        every = [
            PosedFrame(self._frames[k], self._frames.X_WI[k], float(self._frames.times[k]))
            for k in self._sweeps[number]
        ]
        return [
            frame
            for frame, k in zip(every, self._sweeps[number], strict=True)
            if int(self._frames.numbers[k]) not in self._frames.void
        ]

    def _reconstruct(self, number: int) -> ReconstructedVolume:
        with refusing_values(self.path):
            return reconstruct(
                self.sweep(number), spacing=self._spacing, decibels_per_level=self._scale
            )


Opened: TypeAlias = Recording | ReconstructedRecording


def with_frames(reading: Reading, **frames: Any) -> ReadingFrames:
    """Return how volumes are read with what is wanted of 2D frames."""
    return ReadingFrames(**{**vars(reading), **frames})


def open_volumes(path: Path, reading: Reading | None = None, *, timed: bool = True) -> Opened:
    """Open a file of volumes, or of frames to be reconstructed; errors name the file and fault.

    The times of volumes do not matter unless they are ``timed``.
    """
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
        opened = Recording(
            path, depth=options.depth, volume_rate=options.volume_rate, timed=timed, **common
        )
    opened.notes[:0] = known.notes()
    if options.calibration is not None and not opened.posed:
        opened.notes.append("--calibration does not count, as no poses are used")
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
    with refusing_values():
        if reading.motor is not None:
            return MotorSweepVolumes(load_motor_sweep(reading.motor), window=reading.window)
        grey: dict[str, Any] = {
            "window": reading.window,
            "dynamic_range_db": reading.dynamic_range_db,
        }
        if reading.reconstruct:
            return FramesToVolumes(frames=reading.frames, spacing=reading.spacing, **grey)
        return VolumeMaker(depth=reading.depth, **grey)
