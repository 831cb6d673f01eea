"""Checks of a file or a stream before anything is tracked in it; see `source_checks`."""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydrake.math import RotationMatrix

from sonoservo.diagrams.app.options import Reading
from sonoservo.diagrams.app.volumes.opening import (
    Opened,
    ReconstructedRecording,
    live_maker,
    open_volumes,
    with_frames,
)
from sonoservo.systems.calibration.pose_errors import PoseCalibration
from sonoservo.systems.evaluation.reports.scan_sheet import orientation_sheet
from sonoservo.systems.evaluation.source_checks import (
    Check,
    Finding,
    Grade,
    check_across,
    check_contents,
    check_delay,
    check_errors,
    check_grid,
    check_matrices,
    check_motion,
    check_numbers,
    check_pixels,
    check_seen,
    check_stated_step,
    check_times,
    check_volume,
    gravest,
    rows_of_matrices,
    sort_findings,
    sweep_delay,
)
from sonoservo.systems.files.counting import counted
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.volume_file import HoldsFramesError, VolumeFile
from sonoservo.systems.live.connection.address import Address
from sonoservo.systems.live.connection.items import ImageItem, Item, PoseItem
from sonoservo.systems.live.connection.link import Link, shown
from sonoservo.systems.live.image_matcher import ImageMatcher, PosedImage
from sonoservo.systems.live.live_source import LiveSource
from sonoservo.systems.live.pose_history import BRIDGED
from sonoservo.systems.recording.file_items import TimesMissingError
from sonoservo.systems.recording.plus_configuration import read_plus_configuration
from sonoservo.systems.recording.recording import Recording
from sonoservo.systems.recording.valid_frames import Unusable
from sonoservo.systems.signals.volume import Volume

# Most volumes, and sweeps of frames, from which errors of the poses are estimated.
_CALIBRATED, _SWEEPS = 30, 4
# Most images that are kept of a stream, and most devices that are told apart.
_KEPT, _DEVICES = 24, 32
_CAUSES = {
    Unusable.NO_TIME: "the clock",
    Unusable.OUT_OF_ORDER: "the clock",
    Unusable.EMPTY: "the program that wrote them",
}
"""What to look at, by the reason for which volumes or frames are left out; else the tracker."""
_ERROR_MM = 2.0  # Error of a calibration in mm that shows in a needle's place
_LETTERS = ("LR", "PA", "SI")
_SIDES = {"L": "left", "R": "right", "P": "back", "A": "front", "S": "head", "I": "feet"}
_SECONDS = 5.0
_MOST_BYTES = 1 << 30  # most that is read to see whether volumes repeat each other


@dataclass
class CheckedSource:
    """Findings about a path or address, and a picture that marks the probe's side, if any."""

    source: str
    findings: list[Finding] = field(default_factory=list)
    picture: Figure | None = None

    @property
    def gravest(self) -> Finding | None:
        """Gravest finding that needs something to be done; None if none does."""
        return gravest(self.findings)

    def figures(self) -> dict[str, Any]:
        """Return the findings for JSON."""
        worst = self.gravest
        return {
            "source": self.source,
            "needs_something": worst is not None,
            "gravest": None if worst is None else str(worst),
            "findings": [
                {
                    "check": each.check.value,
                    "grade": each.grade.name.lower(),
                    "text": each.text,
                    "advice": each.advice,
                }
                for each in sort_findings(self.findings)
            ],
        }

    def note(self, check: Check, text: str, grade: Grade = Grade.FINE, advice: str = "") -> None:
        """Add a finding."""
        self.findings.append(Finding(check, grade, text, advice))

    def show(self, volume: Volume, R_LP: RotationMatrix) -> None:
        """Check a volume, and make the picture of it."""
        self.findings += check_volume(volume)
        caption = "top: where the probe is taken to be; arrows: directions of the body"
        self.picture = orientation_sheet(volume, R_LP, caption=caption)


def check_file(path: Path, reading: Reading | None = None) -> CheckedSource:
    """Check a file of volumes or frames; a refusal is a finding, a missing file an error."""
    reading = reading or Reading()
    if not path.exists():
        raise ConfigurationError(f"there is no file {path}")
    if path.suffix.lower() == ".xml":
        return check_configuration(path)
    checked, timeless = CheckedSource(str(path)), ""
    try:
        try:
            opened = open_volumes(path, reading)
        except HoldsFramesError:
            opened = open_volumes(path, with_frames(reading, reconstruct=True))
        except TimesMissingError as missing:
            # What needs neither times nor poses is checked all the same.
            opened = open_volumes(path, replace(reading, poses="none"), timed=False)
            timeless = str(missing)
        for note in opened.notes:
            checked.note(Check.READING, note)
        if isinstance(opened, Recording):
            _check_recording(checked, opened, reading)
        else:
            _check_frames(checked, opened, reading)
        if timeless:
            assumed = (Check.RATE, Check.CHAIN)
            checked.findings = [each for each in checked.findings if each.check not in assumed]
            checked.note(Check.RATE, timeless, Grade.WRONG)
    except ConfigurationError as refusal:
        checked.note(Check.READING, f"it cannot be read: {refusal}", Grade.WRONG)
    return checked


def check_configuration(path: Path) -> CheckedSource:
    """Check a device-set configuration of PLUS: its transforms, orientation and time offset."""
    checked = CheckedSource(str(path))
    try:
        known = read_plus_configuration(path)
    except ConfigurationError as refusal:
        checked.note(Check.READING, f"it cannot be read: {refusal}", Grade.WRONG)
        return checked
    checked.note(Check.KIND, f"a configuration of PLUS with {len(known.transforms)} transforms")
    for name, each in known.transforms.items():
        checked.findings += check_matrices(name, each.matrix)
        dated = f"{name}: calibrated {each.date or 'at a time that is not stated'}"
        if np.isnan(each.error):
            checked.note(Check.MATRIX, f"{dated}, with an error that is not stated")
            continue
        grade = Grade.DOUBTFUL if each.error > _ERROR_MM else Grade.FINE
        advice = "calibrate again: a tip is no better known than that" if grade else ""
        checked.note(Check.MATRIX, f"{dated}, with an error of {each.error:g} mm", grade, advice)
    if not any(name.startswith("Image") for name in known.transforms):
        advice = "calibrate the probe; without it, nobody knows where a pixel lies"
        checked.note(Check.CHAIN, "ImageTo... is missing", Grade.DOUBTFUL, advice)
    if known.orientation:
        checked.note(Check.GRID, f"images have the orientation {known.orientation}")
    else:
        advice = "write PortUsImageOrientation (MF: marked side first, then away from the probe)"
        checked.note(
            Check.GRID, "the orientation of the images is not stated", Grade.DOUBTFUL, advice
        )
    offset = f"images are set back by {1e3 * known.time_offset:g} ms against the poses"
    checked.note(Check.DELAY, offset if known.time_offset else "no time offset is stated")
    return checked


def brief_finding(opened: Opened) -> str:
    """Return the gravest of the findings that a header alone tells, on one line; may be empty."""
    file = opened.file
    findings = _check_header(opened)
    if isinstance(opened, Recording):
        findings += check_grid(file.directions, file.shape)
    else:
        findings.append(check_pixels("the frames", opened.pixel_sizes))
    return _on_one_line(gravest(findings), opened.path)


def brief_stream_finding(source: LiveSource) -> str:
    """Return the gravest finding about the times of a stream, on one line; may be empty."""
    return _on_one_line(gravest(check_times(list(source.times), "images")), source.address)


def _on_one_line(worst: Finding | None, source: object) -> str:
    if worst is None:
        return ""
    end = "" if str(worst).endswith("?") else "."
    return f"{worst}{end} `sonoservo check {source}` tells more."


def _check_header(opened: Opened) -> list[Finding]:
    """Check the times and the transforms of all volumes or frames, whether they are used or not."""
    file, times = opened.file, opened.stated_times
    what = "volumes" if isinstance(opened, Recording) else "frames"
    fields = file.frame_fields()
    findings = check_times(times, what)
    if times is file.times:  # neither stamped one by one nor given by --volume-rate
        findings += check_stated_step(times, what)
    for name in sorted(fields):
        if name.endswith("Transform"):
            matrices = rows_of_matrices(fields[name], file.count)
            marks = fields.get(f"{name}Status", {})
            for number, mark in marks.items():
                if number < file.count and mark.upper() != "OK":
                    matrices[number] = np.nan
            short = name.removesuffix("Transform")
            findings += check_matrices(short, matrices)
            findings += check_motion(short, matrices, times)
    return findings


def _check_left_out(opened: Opened, noun: str) -> Iterator[Finding]:
    """Yield why volumes or frames were left out."""
    for reason, numbers in opened.left_out.items():
        text = f"{counted(len(numbers), noun)} {reason}"
        advice = f"look at {_CAUSES.get(reason, 'the tracker')}"
        yield Finding(Check.LEFT_OUT, Grade.DOUBTFUL, text, advice)


def _check_range(volume: Volume, given: float | None, stated: bool) -> Finding:
    """Say how many dB there are from black to white, and whence that is known."""
    text = f"black to white is {255 * volume.decibels_per_level:.3g} dB"
    if given is not None:
        text += ", as --dynamic-range-db says"
    elif stated:
        text += ", as stated with the volumes"
    else:
        text += " by assumption, as nothing states it (--dynamic-range-db does)"
    return Finding(Check.LEVELS, Grade.FINE, text)


def _check_recording(checked: CheckedSource, recording: Recording, reading: Reading) -> None:
    file = recording.file
    size = " x ".join(map(str, file.shape))
    steps = np.linalg.norm(file.directions, axis=0)
    box = " x ".join(f"{each:.0f}" for each in steps * (np.array(file.shape) - 1))
    checked.note(Check.KIND, f"{counted(file.count, 'volume')} of {size} voxels, {box} mm")
    checked.findings += _check_left_out(recording, "volume")
    axes = _axes_words(file.directions)
    depth = f"{_SIDES[reading.depth]} (--depth {reading.depth})"
    checked.note(Check.GRID, f"{axes}; the sound is taken to run to the {depth}")
    checked.findings += check_grid(file.directions, file.shape)
    checked.findings += _check_header(recording)
    posed = "the volumes have poses" if recording.posed else "no poses: the probe counts as at rest"
    checked.note(Check.CHAIN, posed)
    calibrates = recording.posed and len(recording) > 1
    some = np.linspace(0, len(recording) - 1, min(len(recording), _CALIBRATED) * calibrates)
    calibrated = set(some.round().astype(int).tolist())
    middle, calibration = len(recording) // 2, PoseCalibration()
    shares = {}
    # A file that was cut short ends at its last volume.
    for number in sorted({*calibrated, middle, len(recording) - 1}):
        volume = recording[number]
        shares[number] = float(volume.seen.mean())
        if number == middle:
            checked.show(volume, (recording.X_WL(middle).inverse() @ volume.X_WP).rotation())
            given, stated = reading.dynamic_range_db, recording.states_range
            checked.findings.append(_check_range(volume, given, stated))
        if number in calibrated:
            calibration = calibration.seen(volume)
    checked.findings += [*check_numbers(file.read(0)), *check_seen(shares)]
    checked.findings += check_contents(_first_ones(file))
    if calibrates:
        checked.findings += check_errors(calibration.errors)


def _check_frames(
    checked: CheckedSource, volumes: ReconstructedRecording, reading: Reading
) -> None:
    file = volumes.file
    pixels = f"{file.shape[0]} x {file.shape[1]} pixels"
    box = " x ".join(f"{each:.0f}" for each in volumes.pixel_sizes * file.shape[:2])
    checked.note(Check.KIND, f"{file.count} 2D frames of {pixels}, {box} mm")
    checked.findings += _check_left_out(volumes, "frame")
    checked.findings += _check_header(volumes)
    volume = volumes[len(volumes) // 2]
    checked.note(Check.GRID, f"sweeps, each of which makes a volume: {len(volumes)}")
    checked.show(volume, volume.X_WP.rotation())
    checked.findings.append(_check_range(volume, reading.dynamic_range_db, stated=False))
    sweeps = [volumes.sweep(number) for number in range(min(len(volumes), _SWEEPS))]
    checked.findings += [*check_across(sweeps), *check_delay(sweep_delay(sweeps))]
    checked.findings += check_contents(_first_ones(file), "frames")
    if not any(name.startswith("Image") for name in file.frame_fields()):  # else checked above
        checked.findings.append(check_pixels("the frames", volumes.pixel_sizes))


def _first_ones(file: VolumeFile) -> Iterator[NDArray[Any]]:
    """Yield the first volumes or frames of a file as it holds them, up to a number of bytes."""
    total = 0
    for number in range(file.count):
        voxels = file.read(number)
        yield voxels
        total += voxels.nbytes
        if total > _MOST_BYTES:
            return


def _axes_words(directions: NDArray[np.float64]) -> str:
    """Say to which sides of the body the axes of a grid run, whose steps are the columns in LPS."""
    letters = [_letter(axis) for axis in directions.T]
    first, second, third = (_SIDES[each] for each in letters)
    return f"axes run to the body's {first}, {second} and {third} ({', '.join(letters)})"


def _letter(axis: Any) -> str:
    """Return the letter of the body to which an axis runs."""
    largest = int(np.abs(axis).argmax())
    return _LETTERS[largest][int(axis[largest] < 0)]


class _StreamRecord:
    """What comes over a connection for a while: stamps and arrivals by device, and some images."""

    def __init__(
        self,
        address: Address,
        poses: str | None,
        clock_offset: float | None,
        say: Callable[[str], None],
    ) -> None:
        self.link = Link(address, self._receive, say)
        self.matcher = ImageMatcher(
            device=address.device,
            poses=poses,
            clock_offset=clock_offset,
            report=lambda line: None,
        )
        self.stamps: dict[tuple[str, str], deque[float]] = {}
        self.poses: dict[str, deque[tuple[float, Any]]] = {}
        self.images: deque[PosedImage] = deque(maxlen=_KEPT)
        self.frames = 0

    def _receive(self, item: Item, now: float, peer: str) -> None:
        kind = type(item).__name__.removesuffix("Item").lower()
        if len(self.stamps) < _DEVICES or (item.name, kind) in self.stamps:
            self.stamps.setdefault((item.name, kind), deque(maxlen=2000)).append(item.time)
        if isinstance(item, PoseItem) and (len(self.poses) < _DEVICES or item.name in self.poses):
            poses = self.poses.setdefault(item.name, deque(maxlen=2000))
            poses.append((item.time, item.X.GetAsMatrix4()))
        if isinstance(item, ImageItem) and min(item.voxels.shape) == 1:
            self.frames += 1
        self.images.extend(self.matcher.feed(item, now, peer))

    def listen(self, seconds: float, patience: float) -> None:
        """Listen for so long after the first message, and wait so long for it."""
        with self.link:
            began, first = time.perf_counter(), None
            while True:
                now = time.perf_counter()
                if first is None and self.stamps:
                    first = now
                if now - began > patience and first is None:
                    return
                if first is not None and now - first > seconds:
                    return
                if self.link.failure is not None:
                    raise self.link.failure
                time.sleep(0.02)


def check_stream(
    address: Address,
    reading: Reading | None = None,
    *,
    seconds: float = _SECONDS,
    patience: float = 30.0,
    say: Callable[[str], None] = print,
) -> CheckedSource:
    """Check what comes over a connection for so many s after the first message."""
    reading = reading or Reading()
    checked = CheckedSource(str(address))
    record = _StreamRecord(address, reading.poses, reading.clock_offset, say)
    say(f"Listening to {address} for {seconds:g} s; the first message may take {patience:g} s")
    record.listen(seconds, patience)
    if not record.stamps:
        text = f"nothing has come for {patience:g} s"
        advice = "start the scanner's program, and look at address, port and firewall"
        checked.note(Check.READING, text, Grade.WRONG, advice)
        return checked
    devices = ", ".join(f"{shown(name)} ({kind})" for name, kind in sorted(record.stamps))
    skipped = ", ".join(shown(each) for each in sorted(record.link.skipped))
    checked.note(Check.KIND, f"it sends {devices}" + (f"; skipped: {skipped}" if skipped else ""))
    _check_clocks(checked, record, reading.poses)
    left_out = Counter(record.matcher.left_out)
    for why, count in left_out.items():
        checked.note(
            Check.LEFT_OUT, f"{counted(count, 'image')}: {why.value}", Grade.DOUBTFUL,
            "look at poses and clocks; --poses names another transform, --clock-offset states how "
            "far the clocks are apart",
        )  # fmt: skip
    if record.link.refused:
        text = f"{counted(record.link.refused, 'message')} damaged, or without sense"
        checked.note(Check.LEFT_OUT, text, Grade.WRONG, "look at the program that sends them")
    for (name, kind), stamps in sorted(record.stamps.items()):
        if kind in ("image", "pose"):
            checked.findings += check_times(
                np.array(stamps),
                f"messages of {shown(name)}",
                bridged=BRIDGED if kind == "pose" else 0.0,
            )
    for name, poses_seen in record.poses.items():
        times, matrices = zip(*poses_seen, strict=True)
        mm = np.array(matrices)
        mm[:, :3, 3] *= 1e3
        checked.findings += check_motion(shown(name), mm, np.array(times))
    _check_images(checked, record, reading)
    return checked


def _check_clocks(checked: CheckedSource, record: "_StreamRecord", poses: str | None) -> None:
    matcher, others = record.matcher, sorted(record.poses)
    if matcher.counts_arrivals:
        advice = "let the program that sends them stamp them; till then, times are those of arrival"
        text = "time stamps of images stand still or are not in s"
        checked.note(Check.CLOCK, text, Grade.DOUBTFUL, advice)
    if offset := matcher.clock_offset:
        text = f"the clock of the poses is {abs(offset):.2f} s "
        text += "ahead of the images'" if offset > 0 else "behind the images'"
        advice = (
            f"set both clocks by one server, or state the difference (--clock-offset {offset:.2f})"
        )
        checked.note(Check.CLOCK, text, Grade.DOUBTFUL, advice)
    if matcher.chain is not None:
        checked.note(Check.CHAIN, str(matcher.chain))
    if record.images and not matcher.posed and others and poses != "none":
        text = f"none of the transforms is the probe's pose; there are {shown(', '.join(others))}"
        checked.note(Check.CHAIN, text, Grade.DOUBTFUL, "name one with --poses, or give none")


def _check_images(checked: CheckedSource, record: _StreamRecord, reading: Reading) -> None:
    if not record.images:
        if record.frames:
            text = f"{record.frames} 2D frames and no volume"
            advice = "`sonoservo track` makes volumes of them with --reconstruct or --motor"
        else:
            text, advice = "no image", "let the scanner's program send IMAGE messages"
        checked.note(Check.CONTENT, text, Grade.DOUBTFUL, advice)
        return
    maker = live_maker(with_frames(reading))
    volumes, calibration = [], PoseCalibration()
    for posed in record.images:
        volume = maker(posed)
        if isinstance(volume, Volume):
            volumes.append((posed, volume))
        else:
            advice = "such images are left out"
            checked.note(Check.CONTENT, shown(volume.reason), Grade.DOUBTFUL, advice)
    has_poses = record.matcher.posed or maker.posed
    if not has_poses:
        checked.note(Check.CHAIN, "no poses: the probe counts as at rest")
    if not volumes:
        return
    posed, volume = volumes[len(volumes) // 2]
    image = posed.image
    size = " x ".join(map(str, image.voxels.shape))
    checked.note(Check.GRID, f"{size} voxels; {_axes_words(image.X_LI[:3, :3])}")
    checked.findings += check_grid(1e3 * image.X_LI[:3, :3], image.voxels.shape[:3])
    checked.show(volume, (maker.X_WL(posed).inverse() @ volume.X_WP).rotation())
    stated = bool(posed.acquisition and posed.acquisition.decibels_per_level)
    checked.findings.append(_check_range(volume, reading.dynamic_range_db, stated))
    if has_poses:
        for _, each in volumes:
            calibration = calibration.seen(each)
        checked.findings += check_errors(calibration.errors)
