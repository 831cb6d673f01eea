"""One belief about all lines: each is followed, and the needle is the most probable of them.

A needle's far end advances along its own axis. A line at rest keeps its place in the tissue, and
one that rides along keeps its place in the image. The contrasts along a line have a likelihood
under each of these classes (Musicki and Evans 2004; Ristic et al. 2013), so no rule has to tell a
needle from a guide wire, whether the probe moves or not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from sonoservo.systems.sampling.workers import begin, by_parts
from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.line_hypotheses import (
    LINE_CLASSES,
    LineHypotheses,
    LinesExplanation,
)
from sonoservo.systems.signals.search_reason import SearchReason
from sonoservo.systems.signals.volume import Volume, acquired_from
from sonoservo.systems.tracking.arrival import add_volume, advances, class_logs, renewed_shares
from sonoservo.systems.tracking.cells import Cells, cells_of, tissue_shift
from sonoservo.systems.tracking.line_contrast import (
    ALL_NEW,
    BIN,
    BINS,
    MIDDLES,
    Change,
    LineLevels,
    change_between,
    line_levels,
    log_ratio,
    repeat_ratio,
    stretches,
)
from sonoservo.systems.tracking.line_fit import FittedLine, brightness, fitted_lines
from sonoservo.systems.tracking.needle_line import log_odds
from sonoservo.systems.tracking.tissue_motion import TissueMotion

Floats = NDArray[np.float64]

_PACE = 0.5
"""Least time in s from one volume that is followed to the next: a needle that is pushed slowly
passes most of a bin in it. Over less, it looks like a line at rest whose echo changes a little.
Lines that are judged by their looks need not wait."""

_REMEMBERED, _UNCHANGED = 14, 0.5
"""Number of volumes in which a new line is looked for, and of distinct times of arrival: anything
that came before them counts as always there. The oldest tells little about what is new once less
than a share of what it shows is still there."""

_SHOWS = 0.7
"""Probability that a bin of a line shows itself: speckle and shadows hide the others."""

_OTHERS = np.array([0.7, 0.1, 0.2])
"""Prior probabilities that a line which is no needle rests, rides or is nothing but speckle."""

_NEEDLES = 0.004
"""Number of needles that come with a volume, one in some minutes: the more lines come with it, the
fewer of them are needles."""

_BIRTHS = 0.05
"""Share of a volume in the average number of lines that come with one."""

_MISTAKEN = 0.02
"""Probability that a better fit is that of another line."""

_APPEARS = 0.1
"""Ratio of the probability that a line appears at once, as a specular surface comes into view or a
shadow goes, to that with which a bin is drawn anew; measured in volumes without a needle."""

_NEUTRAL, _BEST_LOOKS, _MOST_LOOKS = -4.0, 2.0, (-20.0, 4.0)
"""Log odds of looks that speak neither for nor against a needle (about one in sixty bright lines is
one), the largest that count for a line that moves like a needle, and their limits in one volume."""

_BESIDE, _PARALLEL = 4e-3, 0.05
"""Standard deviations of distances in m and of angles in rad between lines of one structure, such
as the walls of a vessel or the faces of a bone."""

_SAME, _OVERLAP, _BETTER = 3e-3, 10e-3, 4.0
"""Distance in m up to which the ends of two fits belong to one line, length in m by which its
parts may be apart, and sum of contrasts in dB, of one bin, by which a better fit replaces it."""

_KEPT, _LEAST_PROMINENCE, _LINES, _JUDGED = 0.8, 3.0, 150, 40
"""Share of a line's prominence that lasts from volume to volume, the least one, and the numbers of
the most prominent lines that are followed, and that are judged by their looks."""

_LAGS = (1, 4, 12)
"""Numbers of volumes back to those with which a volume is compared."""

_SHIFT = 3e-3
"""Length in m by which breath moves tissue from volume to volume, and from where it rests: more
than a cell, so its displacement is searched from there, too."""


@dataclass(frozen=True, eq=False)
class Remembered(Immutable):
    """A volume with its cells, and how the tissue has moved in W since the first volume."""

    volume: Volume
    cells: Cells
    displacement: Floats
    """(3,) displacement at the volume's time, in m."""
    velocity: Floats
    """(3,) its rate of change in m/s: breath goes on during a sweep."""
    change: Change = ALL_NEW
    """How levels changed along lines since the volume before, at places in the tissue."""
    image_change: Change = ALL_NEW
    """How they changed at places in the image."""

    def in_tissue(self, p_P: Floats) -> Floats:
        """Return (n, 3) places in the tissue, in m, of (n, 3) positions in P."""
        p_W, times = self.volume.to_world(p_P)
        return np.asarray(p_W - self._displaced(times))

    def in_image(self, p_T: Floats) -> Floats:
        """Return (n, 3) positions in P, in m, at which the volume shows (n, 3) places in tissue."""
        p_P = self.volume.X_WP.inverse().multiply((p_T + self.displacement).T).T
        times = self.volume.to_world(p_P)[1]
        return acquired_from(self.volume, p_T + self._displaced(times))

    def in_world(self, p_T: Floats) -> Floats:
        """Return (n, 3) positions in W, in m, of (n, 3) places in the tissue when it was seen."""
        times = self.volume.to_world(self.in_image(p_T))[1]
        return np.asarray(p_T + self._displaced(times))

    def _displaced(self, times: Floats) -> Floats:
        return self.displacement + np.outer(times - self.volume.time, self.velocity)


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines that are followed, in the tissue's frame at the first volume, in m and dB."""

    points: Floats
    """(n, 3) points of abscissa 0."""
    directions: Floats
    spans: Floats
    """(n, 2) abscissae between which a line has been seen."""
    image_points: Floats
    """(n, 3) point in P of the line that keeps its place in the image."""
    image_directions: Floats
    logs: Floats
    """(n, t, BINS) log ratios by time of arrival; see `add_volume`."""
    image_logs: Floats
    """(n, 1, BINS) log ratios along the line that keeps its place in the image."""
    image_levels: NDArray[np.float32]
    """(n, BINS) levels along that line in the newest volume; NaN where unseen."""
    levels: NDArray[np.float32]
    """(n, BINS) levels along the line in the tissue; NaN where unseen."""
    contrasts: NDArray[np.float32]
    prominence: Floats
    """(n,) evidence for a line of any class, averaged over the last volumes."""
    looks: Floats
    """(n,) sum of the log odds by looks, over the volumes counted in ``looked``."""
    looked: Floats
    numbers: Floats
    """(n,) numbers by which the lines are known."""
    classes: Floats
    """(n, 6) log probabilities: needle from either end, resting, riding, appeared, nothing."""
    passed: NDArray[np.int64]
    """(n, 2) numbers of bins that a needle from either end has passed at most."""
    prior: Floats
    """(n, 5) log priors of the classes but "appeared", before anything in ``logs``."""
    past: Floats
    """(n, `_REMEMBERED` + 1, 5) log beliefs before each remembered volume, oldest first, and now. A
    line that is fitted anew is looked for in all of them again, so the oldest becomes its prior."""

    def __len__(self) -> int:
        return len(self.numbers)

    def take(self, rows: NDArray[Any]) -> "Lines":
        """Return some of the lines."""
        return Lines(**{each.name: getattr(self, each.name)[rows] for each in fields(self)})

    def join(self, other: "Lines") -> "Lines":
        """Return these lines and others."""
        names = [each.name for each in fields(self)]
        return Lines(**{n: np.concatenate([getattr(self, n), getattr(other, n)]) for n in names})


def _new_lines(ends: Floats, ends_P: Floats, numbers: Floats, times: int) -> Lines:
    """Return lines with (n, 2, 3) ends in the tissue and in P, of which nothing is known yet."""
    n = len(ends)

    def line(ends: Floats) -> tuple[Floats, Floats, Floats]:
        along = ends[:, 1] - ends[:, 0]
        length = np.linalg.norm(along, axis=1, keepdims=True)
        return ends.mean(axis=1), along / length, length

    points, directions, length = line(ends)
    image_points, image_directions, _ = line(ends_P)
    image_levels, levels, contrasts = np.full((3, n, BINS), np.nan, np.float32)
    return Lines(
        points, directions, 0.5 * length * [-1.0, 1.0], image_points, image_directions,
        np.zeros((n, times, BINS)), np.zeros((n, 1, BINS)),
        image_levels, levels, contrasts,
        np.zeros(n), np.zeros(n), np.zeros(n), numbers, np.zeros((n, 1 + len(LINE_CLASSES))),
        np.full((n, 2), BINS), np.zeros((n, 5)), np.zeros((n, _REMEMBERED + 1, 5)),
    )  # fmt: skip


_NONE = _new_lines(np.zeros((0, 2, 3)), np.zeros((0, 2, 3)), np.zeros(0), 1)


@dataclass(frozen=True, eq=False)
class LineBelief(Immutable):
    """Belief about all lines after the volumes so far."""

    memory: tuple[Remembered, ...] = ()
    """Last volumes, oldest first."""
    motion: TissueMotion = field(default_factory=TissueMotion)
    """Joint belief about how the tissue has moved at their times."""
    lines: Lines = field(default_factory=lambda: _NONE)
    appearing: tuple[float, ...] = (-50.0,)
    """Log prior that a line appeared, by time of arrival; the first time stands for "always"."""
    born: int = 0
    """Number of lines so far."""
    births: float = 0.0
    """Number of lines that come with a volume, averaged over the last ones."""
    time: float = -np.inf

    def rested(self, volume: Volume) -> "LineBelief":
        """Return the belief after a volume in which no line is sought: all are forgotten."""
        return LineBelief(born=self.born, births=self.births, time=volume.time)

    @property
    def hypotheses(self) -> LineHypotheses:
        """What the belief says about the lines in the newest volume."""
        lines = self.lines
        needle = np.logaddexp(lines.classes[:, 0], lines.classes[:, 1])
        looks = lines.looks / np.maximum(lines.looked, 1)
        odds = needle - np.log(-np.expm1(np.minimum(needle, -1e-12)))
        likes = np.minimum(np.where(lines.looked > 0, looks, _NEUTRAL), _BEST_LOOKS)
        odds = odds + likes - _NEUTRAL
        ends = _seen_ends(lines)
        if len(lines):
            # Of improbable needles it does not matter.
            likely = np.flatnonzero(odds > 0)
            volume = self.memory[-1].volume
            odds[likely] -= _of_structures(lines.take(likely), lines, self.births, volume)
            ends = self.memory[-1].in_world(ends.reshape(-1, 3)).reshape(-1, 2, 3)
        backwards = _backwards(lines)
        return LineHypotheses(
            self.time,
            np.where(backwards[:, np.newaxis, np.newaxis], ends[:, ::-1], ends),
            expit(odds),
            np.exp(np.column_stack([needle, lines.classes[:, 2:]])),
            looks,
            lines.looked,
            lines.numbers,
        )


def follow(belief: LineBelief, volume: Volume, *, look: bool = False) -> LineBelief:
    """Return the belief after a later volume; the same if it came too soon to show motion.

    With ``look``, all prominent lines are judged by their looks, not only those that move like a
    needle. Looks need no motion, so no volume is too soon for them.
    """
    if not look and belief.memory and volume.time < belief.time + _PACE:
        return belief
    cells = cells_of(volume)
    seen = begin(lambda: _seen_again(belief, volume, cells))
    fits = fitted_lines(volume, cells)
    lines, memory, motion, appearing = seen()
    born = belief.born
    needle = _needle_prior(belief.births)
    prior = np.log(np.r_[needle / 2, needle / 2, (1 - needle) * _OTHERS])
    lines, born = _add_fits(lines, fits, memory, born, prior)
    births = belief.births + _BIRTHS * (born - belief.born - belief.births)
    order = np.argsort(-lines.prominence, kind="stable")[:_LINES]
    lines = lines.take(order[lines.prominence[order] >= _LEAST_PROMINENCE])
    if len(lines):
        times = np.array([each.volume.time for each in memory])
        moves = np.array([advances(seconds) for seconds in np.diff(times, prepend=times[0])])
        logs, passed = class_logs(
            lines.logs,
            lines.image_logs[:, 0],
            np.array(appearing),
            moves,
            _passing(lines, memory),
        )
        # Needle either way, resting, riding, appeared, nothing.
        joint = np.column_stack([logs, np.zeros(len(lines))])
        joint[:, [0, 1, 2, 3, 5]] += lines.prior
        total = np.logaddexp.reduce(joint, axis=1)
        classes = joint - total[:, np.newaxis]
        now = classes[:, [0, 1, 2, 3, 5]]
        # What appeared rests from then on. Whether it rides shows only while the probe moves.
        still = np.logaddexp.reduce(classes[:, 2:5], axis=1)[:, np.newaxis]
        now[:, 2:4] = still + np.log(_OTHERS[:2] / _OTHERS[:2].sum())
        past = np.concatenate([lines.past[:, :-1], now[:, np.newaxis]], axis=1)
        lines = replace(lines, classes=classes, passed=passed, past=past)
        lines = _judged(lines, memory[-1], fits, look)
    return LineBelief(memory, motion, lines, appearing, born, births, volume.time)


def _seen_again(
    belief: LineBelief, volume: Volume, cells: Cells
) -> tuple[Lines, tuple[Remembered, ...], TissueMotion, tuple[float, ...]]:
    """Return what a later volume makes of the lines, the memory, the motion and `appearing`."""
    (*before, newest), motion = _remember(volume, cells, belief.memory, belief.motion)
    shown = _shown_at(belief.lines, newest)
    newest = replace(
        newest,
        change=change_between(shown.along, belief.lines.levels),
        image_change=change_between(shown.riding, belief.lines.image_levels),
    )
    lines, memory, appearing = belief.lines, (*before, newest), np.array(belief.appearing)
    logs = lines.logs
    if len(memory) > 1:
        appearing = np.append(appearing, np.log(_APPEARS * newest.change.renewed))
        logs = np.concatenate([logs, np.zeros((len(lines), 1, BINS))], axis=1)
    number = 0
    if len(memory) > _REMEMBERED:
        number = _forgotten(memory)
        memory, motion = _without(memory, number), motion.without(number)
        # A bin came with either as probably, and a line that appears with the one or the other.
        logs = _merged(logs, number, axis=1, share=0.5)
        appearing = _merged(appearing, number, axis=0, share=1.0)
    past = np.delete(lines.past, number, axis=1)
    past = np.concatenate([past, np.zeros((len(lines), 1, 5))], axis=1)
    lines = replace(lines, logs=logs, past=past)
    return _look_on(lines, shown, newest), memory, motion, tuple(appearing.tolist())


def _forgotten(memory: Sequence[Remembered]) -> int:
    """Return which of remembered volumes is forgotten, of which the last one is new.

    It is the oldest if too little is `_UNCHANGED` since, or the one whose neighbours are closest to
    each other for their age: whether a needle is fast or slow, it passes as many bins between two
    volumes for each that it has passed since.
    """
    if np.prod([1 - each.change.renewed for each in memory[1:]]) < _UNCHANGED:
        return 0
    times = np.array([each.volume.time for each in memory])
    return 1 + int(np.argmin((times[2:] - times[:-2]) / (times[-1] - times[1:-1])))


def _without(memory: tuple[Remembered, ...], number: int) -> tuple[Remembered, ...]:
    """Return remembered volumes but one, with all changes from one to the next."""
    gone, after = memory[number : number + 2]
    after = replace(
        after,
        change=after.change.since(gone.change),
        image_change=after.image_change.since(gone.image_change),
    )
    return (*memory[:number], after, *memory[number + 2 :])


def _merged(logs: Floats, number: int, axis: int, share: float) -> Floats:
    """Return logarithms by time of arrival of which one and the next, times a share, become one.

    What arrived with the second volume was always there once the first is forgotten.
    """
    logs = np.moveaxis(logs, axis, 0)
    merged = np.delete(logs, max(number, 1), axis=0)
    if number > 0:
        merged[number] = np.logaddexp(logs[number], logs[number + 1]) + np.log(share)
    return np.moveaxis(merged, 0, axis)


def _passing(lines: Lines, memory: Sequence[Remembered]) -> Floats:
    """Return (n, t) bins by which the image moved along lines in tissue before each arrival."""
    p_P = memory[-1].in_image(lines.points)
    places = np.array([each.in_tissue(p_P) for each in memory])
    steps = np.diff(places, axis=0, prepend=places[:1])
    return np.asarray(np.einsum("tni,ni->nt", steps, lines.directions) / BIN)


def _remember(
    volume: Volume, cells: Cells, memory: tuple[Remembered, ...], motion: TissueMotion
) -> tuple[tuple[Remembered, ...], TissueMotion]:
    """Return the memory with one more volume, and the motion of tissue that all of it shows."""
    if not memory:
        return (Remembered(volume, cells, np.zeros(3), np.zeros(3)),), TissueMotion()
    last = memory[-1].displacement
    before = memory[-2].displacement if len(memory) > 1 else last
    guesses = [2 * last - before, *(last + _SHIFT * np.outer([0, -1, 1], [0, 0, 1]))]
    # Where no volume tells, the tissue lies near where it lay last, and near where it rests.
    near = np.eye(3) / _SHIFT**2
    compared = [(len(memory) - 1, np.zeros(3), near)]
    for lag in _LAGS:
        if lag <= len(memory):
            each = memory[-lag]
            R = each.volume.X_WP.rotation().matrix()
            X = each.volume.X_WP.inverse().multiply(volume.X_WP).GetAsMatrix4()
            starts = [R.T @ (each.displacement - guess) for guess in guesses]
            shift, information = tissue_shift(cells, each.cells, X, starts)
            compared.append((len(memory) - lag, -R @ shift, R @ information @ R.T))
            if lag == 1:
                guesses = [last - R @ shift]
    motion = motion.with_volume(near, compared)
    *others, displacement = motion.means
    moved = [replace(each, displacement=now) for each, now in zip(memory, others, strict=True)]
    velocity = (displacement - others[-1]) / (volume.time - memory[-1].volume.time)
    return (*moved, Remembered(volume, cells, displacement, velocity)), motion


class _Shown(NamedTuple):
    """What a volume shows along lines in the tissue, and along those in the image."""

    along: LineLevels
    riding: LineLevels


def _shown_at(lines: Lines, each: Remembered) -> _Shown:
    reach = MIDDLES[-1] / 2 * lines.directions
    n = len(lines)
    p_P = each.in_image(np.concatenate([lines.points - reach, lines.points + reach]))
    along = p_P[n:] - p_P[:n]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    here = _lit(each, 0.5 * (p_P[:n] + p_P[n:]), along)
    return _Shown(here, _lit(each, lines.image_points, lines.image_directions))


@np.errstate(invalid="ignore")
def _lit(each: Remembered, points: Floats, directions: Floats) -> LineLevels:
    """Return the levels along lines in P where sound arrives: a shadow tells nothing."""
    found = line_levels(each.volume, points, directions)
    darkest = each.cells.darkest_at(points[:, 1:2] + MIDDLES * directions[:, 1:2])
    beside = found.levels - found.contrasts
    return found.where(np.minimum(found.levels, beside) > darkest)


@np.errstate(invalid="ignore")
def _add(lines: Lines, shown: _Shown, each: Remembered, begun: int) -> None:
    """Add what a volume shows to the evidence of the lines, for the arrivals so far."""
    for logs, before, now, change in (
        (lines.logs[:, :begun], lines.levels, shown.along, each.change),
        (lines.image_logs, lines.image_levels, shown.riding, each.image_change),
    ):
        ratios, repeats = log_ratio(now.contrasts), repeat_ratio(now, before, change)
        shares = renewed_shares(ratios, repeats, change.renewed)
        add_volume(logs, ratios, repeats, shares, _SHOWS)
        before[:] = now.levels
    lines.contrasts[:] = shown.along.contrasts


def _look_on(lines: Lines, shown: _Shown, newest: Remembered) -> Lines:
    """Return lines after another volume, the last time of arrival."""
    lines = replace(
        lines,
        image_logs=lines.image_logs.copy(),
        image_levels=lines.image_levels.copy(),
        levels=lines.levels.copy(),
        contrasts=lines.contrasts.copy(),
    )
    if len(lines) == 0:
        return lines
    _add(lines, shown, newest, lines.logs.shape[1])
    evidence = stretches(lines.contrasts)[2]
    return replace(lines, prominence=_KEPT * lines.prominence + (1 - _KEPT) * evidence)


def _add_fits(
    lines: Lines,
    fits: Sequence[FittedLine],
    memory: Sequence[Remembered],
    born: int,
    prior: Floats,
) -> tuple[Lines, int]:
    """Return lines with the fits of a volume: better ones replace, and new ones are looked for.

    ``prior`` are the (5,) logarithms of the prior probabilities of new ones.
    """
    if not fits:
        return lines, born
    newest, times = memory[-1], lines.logs.shape[1]
    ends_P = np.array([fit.ends for fit in fits])
    ends = newest.in_tissue(ends_P.reshape(-1, 3)).reshape(-1, 2, 3)
    fresh = _new_lines(ends, ends_P, born + np.arange(len(fits), dtype=np.float64), times)
    now = brightness(lines.contrasts)
    better: dict[int, int] = {}
    taken, new = set[int](), list[int]()
    spans = lines.spans.copy()
    known, alike = _along(fresh, lines), _along(fresh, fresh)
    for number, fit in enumerate(fits):
        here = np.flatnonzero(known[number])
        if len(here):
            best = int(here[np.argmax(now[here])])
            if best in taken:
                continue
            taken.add(best)
            if fit.brightness > now[here].max() + _BETTER:
                better[best] = number
            else:
                a = (ends[number] - lines.points[best]) @ lines.directions[best]
                spans[best] = [min(spans[best, 0], a.min()), max(spans[best, 1], a.max())]
        elif not alike[number, new].any():
            new.append(number)
    changed = [*better.values(), *new]
    if not changed:
        return replace(lines, spans=spans), born
    added = fresh.take(np.array(changed))
    seen = by_parts(lambda part: [_shown_at(added, each) for each in memory[part]], len(memory))
    for begun, (each, shown) in enumerate(
        zip(memory, chain(*seen), strict=True), 1 + times - len(memory)
    ):
        _add(added, shown, each, max(begun, 1))
    added = replace(added, prominence=stretches(added.contrasts)[2])
    olds = np.array(list(better), dtype=int)
    for name in ("looks", "looked", "numbers"):
        getattr(added, name)[: len(olds)] = getattr(lines, name)[olds]
    added.numbers[len(olds) :] = born + np.arange(len(new))
    added.prior[:] = prior
    added.past[:] = prior
    before = lines.past[olds]
    added.past[: len(olds)] = before
    added.prior[: len(olds)] = np.logaddexp(
        before[:, 0] + np.log(1 - _MISTAKEN), prior + np.log(_MISTAKEN)
    )
    kept = np.setdiff1d(np.arange(len(lines)), olds)
    return replace(lines, spans=spans).take(kept).join(added), born + len(new)


def _along(fresh: Lines, lines: Lines) -> NDArray[np.bool_]:
    """Return (m, n) flags of m new lines that lie along n others."""
    ends = (
        fresh.points[:, np.newaxis] + fresh.spans[..., np.newaxis] * fresh.directions[:, np.newaxis]
    )
    away = ends[:, :, np.newaxis] - lines.points
    a = np.sum(away * lines.directions, axis=-1)
    off = np.linalg.norm(away - a[..., np.newaxis] * lines.directions, axis=-1)
    overlap = np.minimum(a.max(axis=1), lines.spans[:, 1]) - np.maximum(
        a.min(axis=1), lines.spans[:, 0]
    )
    return np.asarray((off.max(axis=1) < _SAME) & (overlap > -2 * _OVERLAP))


def _needle_prior(births: float) -> float:
    """Return the prior probability that a line is a needle, if so many come with a volume."""
    return _NEEDLES / max(births, 1.0)


def _of_structures(some: Lines, lines: Lines, births: float, volume: Volume) -> Floats:
    """Return (m,) logarithms by which some of the lines are less probably needles.

    A structure shows itself as several lines side by side, and where it shines moves across it with
    the probe, so one of its lines may seem to advance. A needle lies along them by chance only.
    """
    away = some.points[:, np.newaxis] - lines.points
    a = np.sum(away * lines.directions, axis=-1)
    off = np.linalg.norm(away - a[..., np.newaxis] * lines.directions, axis=-1)
    turn = np.linalg.norm(np.cross(some.directions[:, np.newaxis], lines.directions), axis=-1)
    near = np.exp(-0.5 * ((off / _BESIDE) ** 2 + (turn / _PARALLEL) ** 2))
    # Shares of their lengths that lie beside another one; those across it count for nothing anyway.
    sense = np.sign(some.directions @ lines.directions.T)
    ends = a[..., np.newaxis] + sense[..., np.newaxis] * some.spans[:, np.newaxis]
    beside = np.minimum(ends.max(axis=-1), lines.spans[:, 1]) - np.maximum(
        ends.min(axis=-1), lines.spans[:, 0]
    )
    near *= np.maximum(beside, 0) / np.ptp(some.spans, axis=1)[:, np.newaxis]
    near[some.numbers[:, np.newaxis] == lines.numbers] = 0
    # A still probe does not tell what rests from what rides. A line that is no less probably a
    # needle than when it was new may be another fit of the same needle.
    needle = np.logaddexp(lines.classes[:, 0], lines.classes[:, 1])
    still = np.logaddexp(lines.classes[:, 2], lines.classes[:, 3])
    before = np.log(_needle_prior(births) / _OTHERS[:2].sum())
    rests = -np.exp(still) * np.expm1(np.minimum(needle - still - before, 0))
    field = np.prod(volume.spacing * volume.intensities.shape) ** (2 / 3)
    chance = 2 * np.pi * (_BESIDE * _PARALLEL) ** 2 / field
    return np.asarray(np.log1p(near @ rests / max(rests.sum(), 1.0) / chance))


def explain_lines(belief: LineBelief, count: int = 6) -> LinesExplanation | NotFound:
    """Return the most probable needles, and what all remembered volumes show along the first."""
    hypotheses = belief.hypotheses
    if not hypotheses:
        return NotFound(SearchReason.NO_BRIGHT_LINE(" is followed"))
    best = hypotheses.best(count)
    line = belief.lines.take(np.flatnonzero(belief.lines.numbers == best.numbers[0]))
    outer, sense = (1, -1) if _backwards(line)[0] else (0, 1)
    shown = [_shown_at(line, each).along.contrasts[0, ::sense] for each in belief.memory]
    a = sense * (MIDDLES - _stretches_seen(line)[0, outer])
    times = np.array([each.volume.time for each in belief.memory])
    return LinesExplanation(best, times, a[::sense], np.nan_to_num(shown), np.isfinite(shown))


def _stands_out(lines: Lines) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (n,) first and last bins of the stretches that stand out in the newest volume.

    Of a line that moves like a needle, what lies beyond the needle's end is something else.
    """
    either = lines.classes[:, :2]
    way = np.argmax(either, axis=1)
    passed = np.take_along_axis(lines.passed, way[:, np.newaxis], axis=1)
    bins = np.arange(BINS)
    beyond = np.where(way[:, np.newaxis] == 0, bins, BINS - 1 - bins) >= passed
    beyond &= (np.logaddexp(*either.T) > _NEUTRAL)[:, np.newaxis]
    firsts, lasts, _ = stretches(np.where(beyond, np.float32(np.nan), lines.contrasts))
    return firsts, lasts


def _stretches_seen(lines: Lines) -> Floats:
    """Return (n, 2) abscissae in m between which the lines stand out in the newest volume."""
    firsts, lasts = _stands_out(lines)
    return np.stack(
        [MIDDLES[firsts] - BIN / 2, MIDDLES[np.maximum(lasts, firsts)] + BIN / 2], axis=1
    )


def _seen_ends(lines: Lines) -> Floats:
    """Return (n, 2, 3) ends of the stretches that stand out in the newest volume, in the tissue."""
    a = _stretches_seen(lines)
    return lines.points[:, np.newaxis] + a[..., np.newaxis] * lines.directions[:, np.newaxis]


def _backwards(lines: Lines) -> NDArray[np.bool_]:
    """Return flags of the lines whose second end is the outer one.

    A needle advances from there; one at rest is seen as far as the side of the field of view.
    """
    firsts, lasts = _stands_out(lines)
    bins = np.arange(BINS)
    before, beyond = (
        np.sum(~np.isnan(lines.contrasts) & outside, axis=1)
        for outside in (bins < firsts[:, np.newaxis], bins > lasts[:, np.newaxis])
    )
    surer = lines.classes[:, 1] - lines.classes[:, 0]
    return np.where(np.abs(surer) > 1, surer > 0, beyond < before)


def _judged(lines: Lines, newest: Remembered, fits: Sequence[FittedLine], look: bool) -> Lines:
    """Return lines with the looks of those that may be needles, or of all prominent ones."""
    needle = np.logaddexp(lines.classes[:, 0], lines.classes[:, 1])
    judged = np.arange(len(lines)) < _JUDGED if look else needle > _NEUTRAL - _BEST_LOOKS
    looks, looked = lines.looks.copy(), lines.looked.copy()
    ends = newest.in_image(_seen_ends(lines).reshape(-1, 3)).reshape(-1, 2, 3)
    backwards = _backwards(lines)
    ends = np.where(backwards[:, np.newaxis, np.newaxis], ends[:, ::-1], ends)[judged]
    odds = log_odds(newest.volume, ends, fits, dark_entry=True)
    looks[judged] += np.clip(np.nan_to_num(odds, nan=0.0), *_MOST_LOOKS)
    looked[judged] += ~np.isnan(odds)
    return replace(lines, looks=looks, looked=looked)
