"""Volumes and sequences of volumes with random probes, tissue, structures and needles."""

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from sonoservo.systems.signals import Volume

from .beams import FWHM, Beams, Blur, Display, PointSpread, Raster, splat
from .needles import Needle, Truth
from .structures import KINDS, Medium, draw_structures

SHAPE = (100, 80, 60)
PERIOD = 1 / 3.3


class Scene:
    """A probe on tissue with kinds of structures, laid out for a pose of the probe.

    A probe that moves over the tissue sees scatterers that are points and stay in place.
    """

    def __init__(self, rng, structures=(), shape=SHAPE, spacing=None, moving=False, X_WP=None):
        spacing = np.full(3, rng.uniform(0.5e-3, 0.7e-3) if spacing is None else spacing)
        self.extent = spacing * (np.array(shape) - 1)
        self.X_WT = X_WP or RigidTransform()
        self.beams = draw_beams(rng, self.extent)
        self.spread = PointSpread.draw(rng, self.extent[1])
        self.display = Display.draw(rng)
        self.blur = Blur(self.beams, self.spread)
        self.raster = Raster(self.beams, shape, spacing)
        self.structures = draw_structures(rng, structures, self.extent)
        self.rng = rng
        self.points, self.white = None, None
        if moving:
            self.points = Points(rng, self.extent)
        else:
            white = rng.standard_normal((2, *self.beams.shape), np.float32)
            self.white = (white[0] + np.complex64(1j) * white[1]) / np.sqrt(np.float32(2))
        self._still = (None, None, None)

    def still(self, X_WP):
        """Medium and complex echo of the tissue and its structures, seen from a pose."""
        known, medium, echo = self._still
        if known is not None and known.IsExactlyEqualTo(X_WP):
            return medium, echo
        X_TP = self.X_WT.InvertAndCompose(X_WP)
        grid = self.beams.grid
        if not X_TP.IsNearlyEqualTo(RigidTransform(), 1e-12):
            grid = grid @ X_TP.rotation().matrix().T.astype(np.float32)
            grid += X_TP.translation().astype(np.float32)
        medium = Medium(grid, self.beams.pitch[0])
        for each in self.structures:
            each.apply(medium)
        white = (
            self.white if self.points is None else self.points.seen(self.beams, self.spread, X_TP)
        )
        echo = self.blur((medium.scattering * white + medium.reflecting) * medium.passing)
        self._still = X_WP, medium, echo
        return medium, echo

    def volume(self, X_WP=None, time=0.0, needle=None, inserted=0.0):
        """Volume from a pose at a time in s, and the truth about the needle in it, or None."""
        X_WP = X_WP or self.X_WT
        medium, echo = self.still(X_WP)
        truth = None
        if needle is not None:
            X_PT = X_WP.InvertAndCompose(self.X_WT)
            drawn = needle.draw(self, X_PT, inserted, medium)
            if drawn is not None:
                of_needle, passing, found = drawn
                echo = echo * passing + of_needle
                truth = _truth(needle, X_WP, *found)
        grey = self.raster.convert(self.display.grey(echo, self.rng))
        decibels = self.display.dynamic_range / 255
        raster = self.raster
        return Volume(
            grey, raster.origin, raster.spacing, X_WP, time, decibels_per_level=decibels
        ), truth

    def needle(self, level=None, dip=None, min_length=22e-3):
        """Draw a needle whose path crosses the field of view, in the frame of the structures."""
        rng = self.rng
        while True:
            down = np.radians(rng.uniform(0, 60) if dip is None else dip)
            azimuth = rng.uniform(0, 2 * np.pi)
            flat = np.cos(down) * np.array([np.cos(azimuth), np.sin(azimuth)])
            k = np.array([flat[0], np.sin(down), flat[1]])
            fans = [rng.uniform(-0.6, 0.6) * angle for angle in self.beams.angles]
            middle = self.beams.position(self.extent[1] * rng.uniform(0.2, 0.8), *fans)
            a = np.arange(-0.15, 0.15, 0.25e-3)
            points = middle + a[:, None] * k
            inside = self.beams.contains(points)
            inside &= np.all(np.abs(points[:, [0, 2]]) <= 0.5 * self.extent[[0, 2]], axis=1)
            zero = len(a) // 2
            outside = np.flatnonzero(~inside)
            first = outside[outside < zero].max() + 1
            last = outside[outside > zero].min() - 1
            chord = a[last] - a[first]
            if 0.92 * chord < min_length:
                continue
            length = rng.uniform(min_length, 0.92 * chord)
            if level is None:
                level = rng.uniform(6, 25 - 8 * max(0.0, np.degrees(down) - 30) / 30)
            needle = Needle(rng, middle + a[first] * k, k, length, level)
            if not self.beams.contains(needle.position(length)):
                continue
            X_PT = RigidTransform()
            if len(needle.shaft(self.beams, X_PT, length)[0]) * 0.1e-3 < 0.8 * min_length:
                continue
            needle.calibrate(self, X_PT, self.still(self.X_WT)[0])
            return needle


def _truth(needle, X_WP, p, contrast):
    chosen = np.unique(np.append(np.arange(0, len(p), 5), len(p) - 1))
    p_W = X_WP.multiply(p.T).T
    return Truth(p_W[0], p_W[-1], p_W[chosen], contrast[chosen], needle.radius)


class Points:
    """Scatterers that rest in the tissue (Meunier and Bertrand 1995), in a jittered lattice."""

    def __init__(self, rng, extent, margin=8e-3, pitch=0.75e-3):
        low = np.array([-0.5, 0, -0.5]) * extent - margin
        counts = np.ceil((extent + 2 * margin) / pitch).astype(int)
        lattice = np.indices(counts, np.float32).reshape(3, -1)
        lattice += rng.random(lattice.shape, np.float32)
        self.p_T = (lattice * np.float32(pitch)).T + low.astype(np.float32)
        white = rng.standard_normal((2, len(self.p_T)), np.float32)
        self.amplitude = (white[0] + np.complex64(1j) * white[1]) / np.sqrt(np.float32(2))
        self.density = pitch**-3
        self.wavelength = rng.uniform(0.15e-3, 0.5e-3)

    def seen(self, beams, spread, X_TP):
        """Scatterers at the samples of the beams that have unit power after the blur."""
        X_PT = X_TP.inverse()
        p = self.p_T @ X_PT.rotation().matrix().T + X_PT.translation()
        p, amplitude = p[near := beams.contains(p)], self.amplitude[near]
        index = beams.index(p)
        # The echo's phase turns with the way there and back.
        phase = 4 * np.pi / self.wavelength * beams.axes[0][1] * index[0]
        white = splat(beams.shape, index, amplitude * np.exp(1j * phase), linear=1)
        middle = [len(axis) // 2 for axis in beams.axes]
        steps = np.add(middle, np.eye(3, dtype=int))
        edges = [beams.grid[tuple(step)] - beams.grid[tuple(middle)] for step in steps]
        per_cell = self.density * abs(np.linalg.det(np.array(edges, float)))
        # Spread over two samples, a point loses power unless its echo covers both.
        apart = beams.pitch[0] * FWHM / spread.axial
        kept = (2 + np.exp(-(apart**2) / 4)) / 3
        return (white / np.sqrt(kept * per_cell * beams.cell)).astype(np.complex64)


def draw_beams(rng, extent):
    """Beams of a probe with a flat or a convex face that fill a box of (3,) extents in m."""
    if rng.random() < 0.4:
        radius = 1e2
        return Beams((radius, radius), tuple(0.5 * extent[[0, 2]] / radius), extent[1])
    radii, angles = [], []
    for width in extent[[0, 2]]:
        radius = rng.uniform(12e-3, 60e-3)
        sine = rng.uniform(0.45, 0.52) * width / (extent[1] + radius)
        radii.append(radius)
        angles.append(float(np.arcsin(min(sine, np.sin(np.radians(40))))))
    return Beams(tuple(radii), tuple(angles), extent[1])


def draw_kinds(rng):
    """Names of one to four kinds of structures."""
    return tuple(rng.choice(list(KINDS), rng.integers(1, 5), replace=False).tolist())


def volume_case(rng, needle=True, structures=(), *, level=None, dip=None, **scene):
    """Draw one volume with kinds of structures, and the `Truth` or None.

    Its contrast in dB and its angle below the horizontal in degrees are drawn unless given.
    """
    scene = Scene(rng, structures, **scene)
    if not needle:
        return scene.volume()
    drawn = scene.needle(level, dip)
    return scene.volume(needle=drawn, inserted=drawn.length)


def sequence_case(
    rng, needle, structures, *, shape=SHAPE, level=None, dip=None, speed=None, withdraw=None,
    moving=None, max_volumes=60,
):  # fmt: skip
    """Yield volumes, with the `Truth` or None: an insertion, a stop, and perhaps a withdrawal.

    What is None is drawn. A needle so slow that its insertion would take too long is partly
    inserted from the start.
    """
    moving = rng.random() < 0.4 if moving is None else moving
    turn = RollPitchYaw(rng.uniform(-np.pi, np.pi, 3)).ToRotationMatrix()
    X_WP = RigidTransform(turn, rng.uniform(-0.3, 0.3, 3))
    scene = Scene(rng, structures, shape, None, moving, X_WP)
    motion = _motion(rng) if moving else (lambda time: RigidTransform())
    drawn, times, inserted = None, [0.0, 11.0], [0.0, 0.0]
    if needle:
        drawn = scene.needle(level, dip)
        times, inserted = _insertion(rng, drawn.length, speed, withdraw, max_volumes * PERIOD)
    for i in range(min(max_volumes, int(times[-1] / PERIOD))):
        time = i * PERIOD
        depth = float(np.interp(time, times, inserted))
        shown = drawn if depth > 0 else None
        yield scene.volume(X_WP.multiply(motion(time)), time, shown, depth)


def _insertion(rng, length, speed, withdraw, duration):
    """Times in s, and the distances in m by which the needle is pushed in then."""
    speed = float(np.exp(rng.uniform(np.log(1e-3), np.log(30e-3)))) if speed is None else speed
    withdraw = rng.random() < 0.4 if withdraw is None else withdraw
    before, stop, after = rng.uniform([1, 1.5, 1], [2.5, 4, 2])
    travel = min(length, speed * 0.6 * duration)
    times = [0, before, before + travel / speed, before + travel / speed + stop]
    inserted = [length - travel, length - travel, length, length]
    if withdraw:
        back = rng.uniform(5e-3, 30e-3)
        times += [times[-1] + length / back, times[-1] + length / back + after]
        inserted += [0.0, 0.0]
    return times, inserted


def _motion(rng):
    """Function of time in s that returns a pose of the probe in its frame at the start."""
    size = rng.uniform(-1, 1, 3) * [5e-3, 0, 5e-3]
    turn = np.radians(rng.uniform(-1, 1, 3) * [4, 8, 4])
    rates = 2 * np.pi / rng.uniform(8, 20, 2)

    def pose(time):
        rotation = RollPitchYaw(turn * np.sin(rates[1] * time)).ToRotationMatrix()
        return RigidTransform(rotation, size * np.sin(rates[0] * time))

    return pose
