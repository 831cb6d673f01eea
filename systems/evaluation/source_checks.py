"""Checks of a source of volumes or frames, before anything is tracked in it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum, IntEnum
from itertools import pairwise, takewhile
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import skew
from scipy.stats import t as student

from sonoservo.systems.calibration.pose_errors import PoseErrors, told_errors
from sonoservo.systems.files.volume_file import MAX_STEP, SECONDS
from sonoservo.systems.recording.valid_frames import MAX_TIME, rising
from sonoservo.systems.sampling.interpolation import sample_grid
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.volume import ReconstructedVolume, Volume
from sonoservo.systems.tracking.speckle_width import speckle_spread
from sonoservo.systems.tracking.volume_plausibility import is_noise
from sonoservo.systems.ultrasound.frame_reconstruction import PosedFrame, reconstruct

_STILL = 1e-6  # smallest time in s by which a clock moves on
_GAP = 1.5  # time between two volumes, in periods, from which one of them is missing

_FASTEST_VOLUMES, _FASTEST_FRAMES = 200.0, 2000.0
"""Highest rates in Hz of volumes, and of frames and messages: robots send 1000 poses a second."""

_JITTER = 0.25
"""Standard deviation of the time between two volumes, in periods, above which stamps are those of
arrival rather than of acquisition."""

_NOT_RIGID = 1e-2  # deviation of a matrix from a rotation that rounding to two decimals explains
_STILL_MM, _STILL_DEG = 0.02, 0.01  # spread of poses of a tracker that measures: none is quieter

_LEAST_MM, _SMOOTH = 0.5, 6.0
"""Way in mm that no one moves a probe on purpose, and its ratio to a median step from which it is
a motion: the noise of a tracker at rest spreads over some four steps."""

_FARTHEST_M = 10.0  # farther than any tracker or robot reaches
_LEVER_MM = 1.0  # no tracked tool turns about a point that is nearer to it
_TOOLS = ("Probe", "Image")  # beginnings of the names of transforms from what a hand moves
_INVERTED, _WIDE_MM = 4.0, 50.0
"""Ratio of the motion of a transform to that of its inverse above which that is the probe's: the
world turns widely about a probe that turns. And the least motion in mm that tells."""

_UNITS = {"cm": 10.0, "m": 1e3}  # units that may have been meant, in mm
_SMALLEST_MM = 15.0  # longest edge of a box below which it is too small for a needle in tissue

_COARSEST_MM = 1.0  # largest pixels; inverted calibrations have larger ones

_REPEATED = 0.2
"""Share of poses that repeat the one before to the last digit, above which a tracker is slower."""

_FASTEST = 1.0  # highest speed in m/s at which a hand or a robot moves a probe

_AXIAL_MM, _ACROSS_MM = (0.05, 3.0), (0.15, 12.0)
"""Widths of speckle along and across the sound, of probes from 2 to 20 MHz."""

_BLOCK, _LEAST_BLOCKS = 8e-3, 5
"""Edge length in m of the blocks whose skewness is measured, and number of them that tells it."""

_CLIPPED = 0.05
"""Share of voxels at 0 or at the maximum from which a block is not judged: up to it, clipping at 0
takes the skewness of logarithms from -1.14 to -0.46, and that of amplitudes to 0.70."""

_SKEWED = 0.5
"""Skewness above which numbers are not log-compressed. That of the amplitudes of fully developed
speckle is 0.63, that of their logarithms -1.14, and that of the powers 2; noise and averaging bring
all nearer to 0. A log-compressed volume of our scanner whose tissue is hardly brighter than black
has up to 0.38."""

_SATURATED = (
    0.05  # share of what was seen that is as bright as can be, above which gain hides echoes
)
_UPSIDE_DOWN = 1 / 3  # share of the depth above which the widest part is too near for a sector
_HOLES = 0.9  # share of the usual part of the box below which a volume has holes

_OTHER_AXIS = 1.4  # ratio of speckle widths from which the narrower axis is taken for the sound's
_LATE = 15e-3  # delay of poses in s that shows: a probe at 30 mm/s moves half a millimetre

_DISPLACED, _TURNED_DEG = 2e-3, 2.0
"""Error of a calibration, in m and deg, that shows in a needle's place."""


# Share of a sweep's way that leads out of the image's plane, below which it sweeps none: half, as
# of a probe that moves at 30 deg to its image.
_OUT_OF_PLANE = 0.5

_TRACKER = "look at the tracker: is the tool in its sight?"


class Check(Enum):
    """Subjects of the checks; the values name them in a table."""

    READING = "reading"
    KIND = "kind"
    GRID = "grid"
    SPACING = "spacing"
    SPECKLE = "speckle"
    CONTENT = "content"
    LEVELS = "grey levels"
    RATE = "rate"
    CLOCK = "clock"
    CHAIN = "transforms"
    MATRIX = "matrices"
    MOTION = "motion"
    DELAY = "poses and images"
    LEFT_OUT = "left out"


class Grade(IntEnum):
    """Gravity of a finding; above FINE, something needs doing."""

    FINE = 0
    DOUBTFUL = 1
    WRONG = 2


@dataclass(frozen=True)
class Finding:
    """Outcome of a check: what was found, and what to do, empty if nothing needs doing."""

    check: Check
    grade: Grade
    text: str
    advice: str = ""

    def __str__(self) -> str:
        return f"{self.check.value}: {self.text}" + (f"; {self.advice}" if self.advice else "")


class _Fault(Enum):
    """What may be wrong with a source: subject, gravity, what is said, and what to do."""

    NO_TIME = (Check.RATE, Grade.WRONG, "no time stamp of {count} {what} advances",
               "let the program that acquires them write the time of each")  # fmt: skip
    SLOW = (
        Check.RATE,
        Grade.DOUBTFUL,
        "two {what} are {period:.3g} s apart, as if time stamps were in {unit}",
        "if they are, write them in s, or give the rate (--volume-rate {rate:.3g})",
    )
    FAST = (Check.RATE, Grade.DOUBTFUL,
            "{rate}, faster than any scanner",
            "are times in s declared as ms? Else give the rate (--volume-rate)")  # fmt: skip
    UNIT_STEP = (Check.RATE, Grade.DOUBTFUL,
                 "exactly {rate}, a default of many writers",
                 "is it true? Else give the rate (--volume-rate)")  # fmt: skip
    JITTER = (Check.RATE, Grade.DOUBTFUL, "the time between two {what} varies by {share:.0f} %",
              "let time stamps be those of acquisition, not of arrival or of writing")  # fmt: skip
    GAPS = (Check.RATE, Grade.DOUBTFUL,
            "gaps: {gaps}, the longest {longest:.3g} s; missing {what}: about {missing}",
            "acquire at a rate that disk and network keep up with")  # fmt: skip
    NO_STAMP = (Check.CLOCK, Grade.DOUBTFUL,
                "{what} without a time stamp in range: {missing}; they are left out",
                "let the program that acquires them write the time of each")  # fmt: skip
    CLOCK = (Check.CLOCK, Grade.DOUBTFUL,
             "{how} {back} x, first from number {before} to {number}; {what} left out for it: "
             "{left}",
             "look at the clock of the program that acquires them: was it set?")  # fmt: skip
    NO_MATRIX = (Check.MATRIX, Grade.WRONG, "{name}: no matrix is valid", _TRACKER)
    EMPTY_AXIS = (Check.MATRIX, Grade.WRONG, "{name}: a matrix has an empty axis", _TRACKER)
    SKEW = (Check.MATRIX, Grade.WRONG,
            "{name}: its axes are not at right angles ({skew:.2g} deg)",
            "calibrate again, or take the matrix of the calibration that was accepted")  # fmt: skip
    SCALES = (Check.MATRIX, Grade.WRONG, "{name} is no rotation: it scales by {sizes}",
              "a matrix with the size of a pixel belongs to ImageTo...; any other one must be a "
              "rotation and a position in mm")  # fmt: skip
    MIRRORED = (Check.MATRIX, Grade.WRONG, "{name} is a reflection",
                "let the tracker and the calibration both be right-handed")  # fmt: skip
    UNIT_PIXELS = (Check.MATRIX, Grade.DOUBTFUL,
                   "{said}, as if nobody had calibrated them",
                   "calibrate ImageToProbe")  # fmt: skip
    LOST_POSES = (Check.MOTION, Grade.DOUBTFUL,
                  "{name}: poses missing or marked invalid: {lost} of {count}",
                  "keep the probe in the tracker's sight, or mend the table's rows")  # fmt: skip
    REPEATED = (Check.MOTION, Grade.DOUBTFUL,
                "{name}: {share:.0f} % of the poses repeat the one before",
                "let the tracker measure at least as often as images are taken")  # fmt: skip
    SMALL_WAY = (Check.MOTION, Grade.DOUBTFUL,
                 "{name} moves smoothly, but over {spread:.2g} mm only",
                 "are positions in mm?")  # fmt: skip
    UNMOVED = (Check.MOTION, Grade.DOUBTFUL,
               "{name} turns by {turned:.3g} deg, but moves over {spread:.2g} mm only",
               "are positions in mm?")  # fmt: skip
    INVERTED = (Check.MOTION, Grade.DOUBTFUL,
                "{name} moves over {spread:.3g} mm, and its inverse over {inverse:.3g} mm only",
                "is it the wrong way round?")  # fmt: skip
    JUMPS = (Check.MOTION, Grade.DOUBTFUL,
             "{name} jumps faster than 1 m/s: {jumps} x, by up to {most:.3g} mm",
             _TRACKER)  # fmt: skip
    COARSE_PIXELS = (Check.MATRIX, Grade.DOUBTFUL,
                     "{said}, far larger than those of scanners",
                     "is the calibration the right way round, from pixels to mm?")  # fmt: skip
    UNIT_SPACING = (Check.SPACING, Grade.DOUBTFUL,
                    "{shown} mm, which programs write that do not know it",
                    "look up the size of a voxel, and write it into the header")  # fmt: skip
    SMALL = (Check.SPACING, Grade.DOUBTFUL,
             "{shown} mm: a box whose longest edge is {edge:.3g} mm is too small for a needle in "
             "tissue",
             "is the spacing in {unit}?")  # fmt: skip
    BLANK = (Check.CONTENT, Grade.WRONG, "the volume shows nothing: its numbers are all the same",
             "look at the scanner's gain and whether it was frozen")  # fmt: skip
    UNKNOWN = (Check.CONTENT, Grade.WRONG,
               "the volume holds no echo: each of its numbers is NaN, infinite or stands for what "
               "was not seen",
               "let its program write finite numbers, and look at --void")  # fmt: skip
    NOISE = (Check.CONTENT, Grade.WRONG,
             "neighbouring voxels are unrelated, as in no ultrasound image",
             "look at the type and the byte order that the header states")  # fmt: skip
    LINEAR = (Check.CONTENT, Grade.DOUBTFUL,
              "its numbers are amplitudes or powers, it seems, or it is dark where the echo is "
              "strong: their speckle has a skewness of {skewness:.2f}, and below {most:.2f} if it "
              "is log-compressed",
              "compress amplitudes (20 log10) or powers (10 log10), as scanners do for their "
              "screens, or turn the grey levels round")  # fmt: skip
    SATURATED = (Check.CONTENT, Grade.DOUBTFUL,
                 "{share:.0f} % of what was seen is as bright as can be",
                 "lower the gain, widen --window, or invert the grey levels")  # fmt: skip
    LEFT_HANDED = (Check.GRID, Grade.DOUBTFUL,
                   "its axes are left-handed, so it shows a mirror image unless they are meant to "
                   "be",
                   "look whether the probe's mark is on the right side of the picture, and mend "
                   "the directions of the axes if not")  # fmt: skip
    UPSIDE_DOWN = (Check.GRID, Grade.DOUBTFUL,
                   "the field of view is widest near the probe and narrows with depth, as if the "
                   "sound ran the other way",
                   "if the picture stands on its head, give --depth or mend the axes")  # fmt: skip
    SIGNED = (Check.CONTENT, Grade.DOUBTFUL,
              "its numbers are signed bytes, from -128 to 127; if its program had unsigned ones, "
              "all above 127 are dark now",
              "let the program write unsigned bytes (uint8)")  # fmt: skip
    IN_PLANE = (Check.MOTION, Grade.DOUBTFUL,
                "the frames move in their own plane: only {share:.0f} % of their way leads out of "
                "it",
                "is a transform the wrong way round, From where To belongs? Else sweep across "
                "the image")  # fmt: skip
    HOLES = (Check.CONTENT, Grade.DOUBTFUL,
             "{count} of {read} volumes that were read show less of the box than the others, such "
             "as volume {number}: {share:.0f} % instead of {usual:.0f} %",
             "look for NaN, for lost slices, and for markers of what was not seen")  # fmt: skip
    LOST_SLICES = (Check.CONTENT, Grade.DOUBTFUL,
                   "{count} whole slices in the midst of the box show nothing",
                   "look for NaN, and for markers of what was not seen")  # fmt: skip
    NO_SLICES = (Check.CONTENT, Grade.DOUBTFUL,
                 "{count} of {read} {what} that were read lack whole slices in their midst (NaN), "
                 "such as number {number}: {share:.3g} % of its voxels are there",
                 "look for slices that the scanner or its program lost")  # fmt: skip
    FROZEN = (Check.CONTENT, Grade.DOUBTFUL,
              "{count} of {read} {what} that were read repeat the one before exactly, such as "
              "number {number}",
              "was the scanner frozen, or does its program write faster than it?")  # fmt: skip
    NOTHING = (Check.CONTENT, Grade.DOUBTFUL,
               "{count} of {read} {what} that were read show nothing, such as number {number}",
               "look for NaN, at the gain, and whether the probe had contact")  # fmt: skip
    HOLLOW = (Check.CONTENT, Grade.DOUBTFUL, "{text}",
              "if it is a reconstruction, sweep more slowly or make its voxels larger; else look "
              "at gain, threshold and window")  # fmt: skip
    OTHER_AXIS = (Check.SPECKLE, Grade.DOUBTFUL,
                  "{text}: it is finest {finest}, as if the sound ran there",
                  "try another direction of the sound (--depth), and check the spacing of that "
                  "axis")  # fmt: skip
    WIDTH = (Check.SPECKLE, Grade.DOUBTFUL,
             "{text}: {where}, {least:g} to {most:g} mm are usual",
             "is the spacing in mm, and that of this axis?")  # fmt: skip
    POSES = (Check.DELAY, Grade.DOUBTFUL, "{text}",
             "let `sonoservo track --correct-poses` correct them, or calibrate again")  # fmt: skip
    LATE = (Check.DELAY, Grade.DOUBTFUL, "{text}",
            "calibrate the delay (in PLUS, the temporal offset of the devices), and record "
            "again")  # fmt: skip

    def __call__(self, **figures: Any) -> Finding:
        check, grade, text, advice = self.value
        return Finding(check, grade, text.format(**figures), advice.format(**figures))


def _fine(check: Check, text: str) -> Finding:
    return Finding(check, Grade.FINE, text)


def gravest(findings: Iterable[Finding]) -> Finding | None:
    """Return the gravest finding that needs something to be done, the first of several."""
    grave = [each for each in findings if each.grade > Grade.FINE]
    return max(grave, key=lambda each: each.grade, default=None)


def check_times(times: ArrayLike, what: str = "volumes", *, bridged: float = 0.0) -> list[Finding]:
    """Check the rate of volumes or frames, how steady it is, and what is missing.

    Gaps of up to a time ``bridged`` in s are no loss, as those between poses.
    """
    every = np.asarray(times, float)
    there = np.flatnonzero(np.abs(every) <= MAX_TIME)
    if len(there) <= 1:
        return [_fine(Check.RATE, "a single one, so there is no rate")] if len(there) else []
    kept = np.flatnonzero(rising(every))
    if len(kept) < 2:
        return [_Fault.NO_TIME(count=len(there), what=what)]
    # Between two that are kept, others may have been left out: they are no gap.
    steps, passed = np.diff(every[kept]), np.diff(kept)
    near = steps[passed == passed.min()] / passed.min()
    period = float(np.median(near))
    jitter = float(np.sqrt(np.mean(np.clip(near / period - 1, -_GAP, _GAP - 1) ** 2)))
    rate = _rate(1 / period, what)
    text = f"{rate} over {steps.sum():.3g} s, jitter {1e3 * jitter * period:.1f} ms"
    findings = [_fine(Check.RATE, text)]
    if period > MAX_STEP:
        unit = "ms" if SECONDS["ms"] * period <= MAX_STEP else "us"
        meant = 1 / (SECONDS[unit] * period)
        findings.append(_Fault.SLOW(what=what, period=period, unit=unit, rate=meant))
    if 1 / period > (_FASTEST_VOLUMES if what == "volumes" else _FASTEST_FRAMES):
        findings.append(_Fault.FAST(rate=rate))
    if jitter > _JITTER:
        findings.append(_Fault.JITTER(what=what, share=100 * jitter))
    missing = steps / period - passed
    # A stamp that is early, as one that repeats is, makes the next step long.
    missing[1:] += np.minimum(missing[:-1], 0)
    gaps = (missing > _GAP - 1) & (steps > bridged)
    if gaps.any():
        longest, about = steps[gaps].max(), int(np.round(missing[gaps]).sum())
        found = _Fault.GAPS(gaps=int(gaps.sum()), longest=longest, missing=about, what=what)
        findings.append(found)
    if len(there) < len(every):
        findings.append(_Fault.NO_STAMP(missing=len(every) - len(there), what=what))
    if len(kept) < len(there):
        earlier, later = every[there][:-1], every[there][1:]
        back, most = np.flatnonzero(earlier > later - _STILL), (earlier - later).max()
        found = _Fault.CLOCK(
            how="time stands still"
            if most <= _STILL
            else f"time stands still or runs back (by up to {most:.3g} s)",
            back=len(back),
            before=there[back[0]],
            number=there[back[0] + 1],
            left=len(there) - len(kept),
            what=what,
        )
        findings.append(found)
    return findings


def check_stated_step(times: ArrayLike, what: str = "volumes") -> list[Finding]:
    """Check that a header's (n,) times in s do not advance by what programs write by default."""
    steps = np.diff(np.asarray(times, float))
    default = len(steps) and np.allclose(steps, 1.0, atol=1e-6)
    return [_Fault.UNIT_STEP(rate=_rate(1.0, what))] if default else []


def _rate(rate: float, what: str) -> str:
    """Return a rate in words, of things in the plural that may be followed by their kind."""
    things, *of = what.split(" ", 1)
    number = f"{float(f'{rate:.3g}'):g}"
    return " ".join([number, things.removesuffix("s" * (number == "1")), *of, "a second"])


def check_matrices(name: str, matrices: ArrayLike) -> list[Finding]:
    """Check that the matrices of a transform are rigid motions, or pixel sizes for an image."""
    each = np.asarray(matrices, float).reshape(-1, 4, 4)
    each = each[np.isfinite(each).all(axis=(1, 2))]
    if not len(each):
        return [_Fault.NO_MATRIX(name=name)]
    scales = np.linalg.norm(each[:, :3, :3], axis=1)
    if not (scales > 0).all():
        return [_Fault.EMPTY_AXIS(name=name)]
    unit = each[:, :3, :3] / scales[:, np.newaxis]
    skew = float(np.abs(np.swapaxes(unit, 1, 2) @ unit - np.eye(3)).max())
    scale = np.median(scales, axis=0)
    if skew > _NOT_RIGID:
        return [_Fault.SKEW(name=name, skew=np.degrees(skew))]
    if name.startswith("Image"):
        return [check_pixels(name, scale[:2])]
    if np.abs(scale - 1).max() > _NOT_RIGID:
        return [_Fault.SCALES(name=name, sizes=" x ".join(f"{each:.4g}" for each in scale))]
    if (np.linalg.det(unit) < 0).any():
        return [_Fault.MIRRORED(name=name)]
    return [_fine(Check.MATRIX, f"{name}: a rigid motion")]


def check_pixels(name: str, sizes: ArrayLike) -> Finding:
    """Check the (2,) sizes of an image's pixels in mm."""
    x, y = np.asarray(sizes, float).tolist()
    said = f"{name}: pixels of {x:.4g} x {y:.4g} mm"
    if np.allclose([x, y], 1, atol=1e-6):
        return _Fault.UNIT_PIXELS(said=said)
    return (
        _Fault.COARSE_PIXELS(said=said) if max(x, y) > _COARSEST_MM else _fine(Check.MATRIX, said)
    )


def check_motion(name: str, matrices: ArrayLike, times: ArrayLike) -> list[Finding]:
    """Check that poses move as those of a probe do, and do not only repeat."""
    each = np.asarray(matrices, float).reshape(-1, 4, 4)
    there = np.isfinite(each).all(axis=(1, 2))
    findings = []
    if (lost := int((~there).sum())) and there.any():
        findings.append(_Fault.LOST_POSES(name=name, lost=lost, count=len(there)))
    each, at = each[there], np.asarray(times, float)[there]
    if len(each) < 3:
        return findings
    p = each[:, :3, 3]
    R = each[:, :3, :3] / np.linalg.norm(each[:, :3, :3], axis=1)[:, np.newaxis]
    turned = np.degrees(np.sqrt(np.square(R - R[0]).sum(axis=(1, 2)).max() / 2))
    spread, inverse = (
        float(np.ptp(each, axis=0).max()) for each in (p, np.einsum("nji,nj->ni", R, p))
    )
    if spread < _STILL_MM and turned < _STILL_DEG:
        text = f"{name} never moves in {len(each)} poses"
        if name.startswith("Probe"):
            text += (
                ", as of a probe that is held: delay and calibration cannot be judged, nor whether "
                "a tracker repeats its last pose"
            )
        return [*findings, _fine(Check.MOTION, text)]
    if spread < _LEVER_MM * np.radians(turned):
        findings.append(_Fault.UNMOVED(name=name, spread=spread, turned=turned))
    elif _SMOOTH * _usual_step(p) < spread < _LEAST_MM and np.abs(p).max() < _FARTHEST_M:
        findings.append(_Fault.SMALL_WAY(name=name, spread=spread))
    elif name.startswith(_TOOLS) and spread > max(_INVERTED * inverse, _WIDE_MM):
        findings.append(_Fault.INVERTED(name=name, spread=spread, inverse=inverse))
    else:
        text = f"{name} moves over {spread:.3g} mm and {turned:.3g} deg"
        findings.append(_fine(Check.MOTION, text))
    same = (each[1:] == each[:-1]).all(axis=(1, 2))
    if same.mean() > _REPEATED:
        findings.append(_Fault.REPEATED(name=name, share=100 * same.mean()))
    steps, dt = 1e-3 * np.linalg.norm(np.diff(p, axis=0), axis=1), np.diff(at)
    jumps = steps > _FASTEST * np.where(dt > 0, dt, np.inf)
    if jumps.any():
        most = 1e3 * steps[jumps].max()
        findings.append(_Fault.JUMPS(name=name, jumps=int(jumps.sum()), most=most))
    return findings


def _usual_step(p: NDArray[np.float64]) -> float:
    """Return the median of the steps between (n, 3) positions that differ, in their unit."""
    steps = np.abs(np.diff(p, axis=0)).max(axis=1)
    return float(np.median(steps[steps > 0])) if steps.any() else 0.0


def check_grid(directions: NDArray[np.float64], shape: ArrayLike) -> list[Finding]:
    """Check (3, 3) steps between voxels in mm, one a column, for mirroring, defaults and units."""
    mirrored = [_Fault.LEFT_HANDED()] if np.linalg.det(directions) < 0 else []
    return [*mirrored, *_check_spacing(np.linalg.norm(directions, axis=0), shape)]


def _check_spacing(steps: NDArray[np.float64], shape: ArrayLike) -> list[Finding]:
    shown = " x ".join(f"{each:.4g}" for each in steps)
    if np.allclose(steps, 1.0, atol=1e-6):
        return [_Fault.UNIT_SPACING(shown=shown)]
    edge = float((steps * np.asarray(shape)).max())
    if edge < _SMALLEST_MM:
        unit = next((unit for unit, mm in _UNITS.items() if mm * edge >= _SMALLEST_MM), "m")
        return [_Fault.SMALL(shown=shown, edge=edge, unit=unit)]
    return [_fine(Check.SPACING, f"{shown} mm")]


def check_volume(volume: Volume) -> list[Finding]:
    """Check the contrast of a volume, its empty part and its speckle."""
    if not volume.seen.any():
        return [_Fault.UNKNOWN()]
    if float(volume.intensities.max()) - float(volume.intensities.min()) <= 0:
        return [_Fault.BLANK()]
    if is_noise(volume):
        return [_Fault.NOISE()]
    compression = _check_compression(volume)
    return [
        _check_empty(volume),
        *_check_slices(volume),
        *compression,
        *([] if gravest(compression) else _check_saturation(volume)),
        *_check_direction(volume),
        _check_speckle(volume),
    ]


def check_seen(shares: Mapping[int, float]) -> list[Finding]:
    """Check the parts of the box that volumes show, by their numbers: none shows much less.

    The first ones may: the probe has no contact yet.
    """
    usual = float(np.median([*shares.values()]))
    odd = [number for number, share in shares.items() if share < _HOLES * usual]
    before = [*takewhile(odd.__contains__, shares)]
    found = list[Finding]()
    if before:
        text = (
            f"the first volumes, {len(before)} of {len(shares)} that were read, show little, as a "
            f"probe without contact does: {100 * shares[before[0]]:.0f} % of the box instead of "
            f"{100 * usual:.0f} %"
        )
        found.append(_fine(Check.CONTENT, text))
    if later := odd[len(before) :]:
        number = later[0]
        fault = _Fault.HOLES(
            count=len(later),
            read=len(shares),
            number=number,
            share=100 * shares[number],
            usual=100 * usual,
        )
        found.append(fault)
    return found


def _check_slices(volume: Volume) -> list[Finding]:
    """Check that what was seen has no gap of whole slices, as a sparse sweep has between frames."""
    if isinstance(volume, ReconstructedVolume):
        return []
    lost = _lost_slices(volume.seen)
    return [_Fault.LOST_SLICES(count=lost)] if lost else []


def _lost_slices(seen: NDArray[np.bool_]) -> int:
    """Return how many slices, of (nx, ny, nz, ...) flags of which one is set, lie in gaps."""
    lost = 0
    for axis in range(3):
        shown = np.flatnonzero(seen.any(axis=tuple({*range(seen.ndim)} - {axis})))
        lost += int(shown[-1] - shown[0] + 1) - len(shown)
    return lost


def _check_saturation(volume: Volume) -> list[Finding]:
    share = float((volume.intensities[volume.seen] >= volume.intensities.max()).mean())
    return [_Fault.SATURATED(share=100 * share)] if share > _SATURATED else []


def _check_direction(volume: Volume) -> list[Finding]:
    """Check that a sector becomes wider with depth; a box of one width tells nothing."""
    if isinstance(volume, ReconstructedVolume):
        return []
    widths = np.trim_zeros(volume.seen.sum(axis=(0, 2)))
    widest = np.flatnonzero(widths >= 0.95 * widths.max()).mean() / len(widths)
    return [_Fault.UPSIDE_DOWN()] if widest < _UPSIDE_DOWN else []


def _check_compression(volume: Volume) -> list[Finding]:
    """Check that speckle is skewed as that of log-compressed echoes, where little is clipped."""
    shape = np.array(volume.intensities.shape)
    size = np.clip(np.round(_BLOCK / volume.spacing).astype(int), 1, shape)
    number = shape // size
    whole = volume.intensities[tuple(slice(n) for n in number * size)].astype(float)
    split = whole.reshape(np.column_stack([number, size]).ravel()).transpose(0, 2, 4, 1, 3, 5)
    blocks = split.reshape(number.prod(), size.prod())
    clipped = ((blocks == 0) | (blocks >= volume.intensities.max())).mean(axis=1)
    judged = blocks[(clipped < _CLIPPED) & (np.ptp(blocks, axis=1) > 0)]
    if len(judged) < _LEAST_BLOCKS:
        text = (
            "whether its numbers are log-compressed cannot be judged: "
            f"{len(judged)} of {len(blocks)} blocks of {1e3 * _BLOCK:g} mm show something with "
            f"less than {100 * _CLIPPED:g} % cut off at black or white; {_LEAST_BLOCKS} are needed"
        )
        return [_fine(Check.CONTENT, text)]
    skewness = float(np.median(skew(judged, axis=1)))
    return [_Fault.LINEAR(skewness=skewness, most=_SKEWED)] if skewness > _SKEWED else []


def _check_empty(volume: Volume) -> Finding:
    seen = volume.seen
    if isinstance(volume, ReconstructedVolume):
        empty, what = 1 - float(seen.mean()), "of the box lies between no two frames"
        limit = 0.75
    else:
        empty, what = float((volume.intensities[seen] == 0).mean()), "of what was seen is black"
        limit = 0.4
    text = f"{100 * seen.mean():.0f} % of the box was seen, {100 * empty:.0f} % {what}"
    return _fine(Check.CONTENT, text) if empty <= limit else _Fault.HOLLOW(text=text)


def _check_speckle(volume: Volume) -> Finding:
    spread = speckle_spread(volume)
    if spread is None:
        text = "no speckle was found that could tell whether the spacing is right"
        return _fine(Check.SPECKLE, text)
    lateral, axial, elevation = (
        1e3 * float(np.median(each)) for each in (spread.lateral, spread.axial, spread.elevation)
    )
    text = (
        f"{axial:.2g} mm along the sound, {lateral:.2g} mm laterally, "
        f"{elevation:.2g} mm in elevation"
    )
    if axial > _OTHER_AXIS * min(lateral, elevation):
        finest = "laterally" if lateral < elevation else "in elevation"
        return _Fault.OTHER_AXIS(text=text, finest=finest)
    for width, (least, most), where in (
        (axial, _AXIAL_MM, "along the sound"),
        (lateral, _ACROSS_MM, "laterally"),
        (elevation, _ACROSS_MM, "in elevation"),
    ):
        if not least <= width <= most:
            return _Fault.WIDTH(text=text, where=where, least=least, most=most)
    return _fine(Check.SPECKLE, text)


def check_errors(errors: PoseErrors | NotFound) -> list[Finding]:
    """Check delay and calibration of the poses, as tissue that stands still tells them."""
    errors = told_errors(errors)
    if isinstance(errors, NotFound):
        text = f"whether poses are late or the calibration is off is unknown: {errors.reason}"
        return [_fine(Check.DELAY, text)]
    told, half = errors.told, 2 * errors.std
    moved, moved_half, turned, turned_half = (
        float(np.linalg.norm(each[part][told[part]]))
        for part in (slice(1, 4), slice(4, 7))
        for each in (np.array([0, *errors.translation, *errors.rotation]), half)
    )
    off = [
        *([f"displaced by {1e3 * moved:.1f} mm"] if told[1:4].any() else []),
        *([f"turned by {np.degrees(turned):.1f} deg"] if told[4:].any() else []),
    ]
    known = [
        *([_late(errors.delay, half[0])] if told[0] else []),
        *([f"the image is {' and '.join(off)} against its calibration"] if off else []),
    ]
    unknown = [
        *([] if told[0] else ["whether poses are late"]),
        *([] if told[1:].all() else [f"how{' else' if off else ''} the image is off"]),
    ]
    text = ", ".join(known)
    if unknown:
        text += f"; to learn {' and '.join(unknown)}, move and turn the probe more"
    late = told[0] and abs(errors.delay) > max(half[0], _LATE)
    displaced = moved > _DISPLACED + moved_half
    rotated = np.degrees(turned - turned_half) > _TURNED_DEG
    wrong = late or displaced or rotated
    return [_Fault.POSES(text=text) if wrong else _fine(Check.DELAY, text)]


def check_numbers(voxels: NDArray[Any]) -> list[Finding]:
    """Check the kind of a volume's numbers as the file holds them."""
    return [_Fault.SIGNED()] if voxels.dtype == np.int8 else []


def check_contents(volumes: Iterable[NDArray[Any]], what: str = "volumes") -> list[Finding]:
    """Check that volumes or frames, as the file holds them, show something, and not one thing."""
    last, read = None, 0
    repeats, nothing, shares = list[int](), list[int](), dict[int, float]()
    for read, voxels in enumerate(volumes, 1):
        known = np.isfinite(voxels)
        if voxels.min() == voxels.max() or not known.any():
            nothing.append(read - 1)
        elif last is not None and np.array_equal(voxels, last, equal_nan=True):
            repeats.append(read - 1)
        elif not known.all() and _lost_slices(known):  # most files hold no NaN at all
            shares[read - 1] = 100 * float(known.mean())
        last = voxels
    found = [
        fault(count=len(numbers), read=read, what=what, number=numbers[0])
        for fault, numbers in ((_Fault.NOTHING, nothing), (_Fault.FROZEN, repeats))
        if numbers
    ]
    if shares:
        number, share = next(iter(shares.items()))
        found.append(
            _Fault.NO_SLICES(count=len(shares), read=read, what=what, number=number, share=share)
        )
    return found


def check_across(sweeps: Sequence[Sequence[PosedFrame]]) -> list[Finding]:
    """Check that the corners of frames leave the image's plane from a sweep's start to its end."""
    out, way = 0.0, 0.0
    for sweep in filter(None, sweeps):  # all frames of one may hold nothing
        first, last = sweep[0].X_WI, sweep[-1].X_WI
        i, j = sweep[0].pixels.shape[:2]
        corners = np.array([[0, 0, 0, 1], [i, 0, 0, 1], [0, j, 0, 1], [i, j, 0, 1]])
        moved = (corners @ (last - first).T)[:, :3]
        normal = np.cross(first[:3, 0], first[:3, 1])
        out += float(np.abs(moved @ normal).sum() / np.linalg.norm(normal))
        way += float(np.linalg.norm(moved, axis=1).sum())
    return [_Fault.IN_PLANE(share=100 * out / way)] if out < _OUT_OF_PLANE * way else []


def check_delay(found: tuple[float, float] | NotFound) -> list[Finding]:
    """Check the delay of poses, and its standard deviation, in s (`sweep_delay`)."""
    if isinstance(found, NotFound):
        return [_fine(Check.DELAY, f"whether poses are late is unknown: {found.reason}")]
    delay, half = found[0], 2 * found[1]
    text = f"{_late(delay, half)}, by sweeps to and fro"
    right = abs(delay) <= max(half, _LATE)
    return [_fine(Check.DELAY, text) if right else _Fault.LATE(text=text)]


def _late(delay: float, half: float) -> str:
    middle, low, high = (round(1e3 * each) for each in (delay, delay - half, delay + half))
    return f"poses are late by {middle} ms (95 %: {low} to {high})"


def sort_findings(findings: Sequence[Finding]) -> list[Finding]:
    """Return findings in the order of their checks, as a table shows them."""
    order = list(Check)
    return sorted(findings, key=lambda each: order.index(each.check))


def rows_of_matrices(texts: dict[int, str], count: int) -> NDArray[np.float64]:
    """Return (count, 4, 4) matrices of texts of 16 numbers by number; NaN where there is none."""
    matrices = np.full((count, 4, 4), np.nan)
    for number, text in texts.items():
        words = text.split()
        if number < count and len(words) == 16:
            try:
                matrices[number] = np.array(words, float).reshape(4, 4)
            except ValueError:
                continue
    return matrices


_LATEST, _STEPS = 0.25, 11
"""Largest delay in s that is considered, and number of delays that are tried."""

_SPACING = 1.2e-3
_LEAST_VOXELS = 500
_LEAST_PAIRS = 2


def sweep_delay(sweeps: Sequence[Sequence[PosedFrame]]) -> tuple[float, float] | NotFound:
    """Return the delay of poses in s at which sweeps to and fro agree, and half its 95 %."""
    delays = [
        best
        for earlier, later in pairwise(sweeps)
        if (best := _best_delay(earlier, later)) is not None
    ]
    if len(delays) < _LEAST_PAIRS:
        return NotFound("fewer than three sweeps to and fro show the same tissue")
    count = len(delays)
    wide = float(student.ppf(0.975, count - 1)) / 2
    return float(np.mean(delays)), wide * float(np.std(delays, ddof=1)) / count**0.5


def _best_delay(earlier: Sequence[PosedFrame], later: Sequence[PosedFrame]) -> float | None:
    tried = np.linspace(-_LATEST, _LATEST, _STEPS)
    alike = np.array([_likeness(earlier, later, delay) for delay in tried])
    if not np.isfinite(alike).all():
        return None
    best = int(alike.argmax())
    if not 0 < best < _STEPS - 1:
        return None
    before, at, after = alike[best - 1 : best + 2]
    bend = before - 2 * at + after
    return float(tried[best] + (tried[1] - tried[0]) * 0.5 * (before - after) / bend)


def _likeness(earlier: Sequence[PosedFrame], later: Sequence[PosedFrame], delay: float) -> float:
    """Return the correlation of two sweeps whose poses are late by a delay; NaN if they miss."""
    frames = [*earlier, *later]
    order = np.argsort([frame.time for frame in frames], kind="stable")
    times = np.array([frames[k].time for k in order])
    poses = np.array([frames[k].X_WI for k in order]).reshape(-1, 16)
    try:
        first, second = (
            reconstruct(_shifted(sweep, times, poses, delay), spacing=_SPACING)
            for sweep in (earlier, later)
        )
    except ValueError:  # too few frames are left, or the sweep is too large
        return np.nan
    inner = np.argwhere(~first.holes)[::3]
    X = second.X_WP.InvertAndCompose(first.X_WP)
    p = X.multiply(first.position(inner).T).T
    filled = sample_grid((~second.holes).astype(np.float32), p, second.origin, second.spacing, 0.0)
    there = filled > 0.99
    if there.sum() < _LEAST_VOXELS:
        return np.nan
    here = first.intensities[tuple(inner[there].T)].astype(float)
    other = sample_grid(second.intensities, p[there], second.origin, second.spacing, 0.0)
    if not np.ptp(here) or not np.ptp(other):
        return np.nan
    return float(np.corrcoef(here, other)[0, 1])


def _shifted(
    sweep: Sequence[PosedFrame],
    times: NDArray[np.float64],
    poses: NDArray[np.float64],
    delay: float,
) -> list[PosedFrame]:
    """Return frames with poses stamped ``delay`` s later; frames past the last pose drop out."""
    shifted = []
    for frame in sweep:
        at = frame.time + delay
        if times[0] <= at <= times[-1]:
            entries = [np.interp(at, times, poses[:, k]) for k in range(16)]
            shifted.append(replace(frame, X_WI=np.reshape(entries, (4, 4))))
    return shifted
