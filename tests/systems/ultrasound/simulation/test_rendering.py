"""Contact, the phantom's bounds and grey levels of a rendered sweep."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from renderers import CLEAN, DOWN, NOWHERE, make_renderer, needle_through, still

from sonoservo.systems.ultrasound import ImagingParameters, Transducer
from sonoservo.systems.ultrasound.simulation import NeedleEchoParameters, SweepRenderer, Tissue
from sonoservo.systems.ultrasound.simulation.frame_renderer import FrameRenderer, Frames
from sonoservo.systems.ultrasound.simulation.structures.kinds import FatLayer


def test_default_grey_levels_leave_room_for_the_needle():
    """Tissue between 70 and 95; a needle across the beam from 215 up, hardly ever saturating."""
    renderer = make_renderer(focus_depth=0.025)
    for depth in (0.03, 0.07):
        needle = needle_through([0, 0, -0.1 - depth], 0.3, 0.0)
        grey = renderer.render(still(renderer), [needle] * 27, 1, 0)
        assert 70 < grey[:5].mean() < 95
        assert grey.max() >= 215
        assert (grey == 255).sum() < 30


def test_noise_grows_with_depth_as_sound_is_attenuated():
    tissue = Tissue(size=[0.001, 0.001, 0.001], attenuation=0.5)  # nothing to see
    renderer = SweepRenderer(
        transducer=Transducer(), imaging=ImagingParameters(gain=1.0), tissue=tissue,
        parameters=replace(CLEAN, noise_db=-40.0, gel_thickness=1.0), seed=0,
    )  # fmt: skip
    grey = renderer.render(still(renderer), [NOWHERE] * 27, 1, 0).astype(float)
    levels = grey.mean(axis=(0, 1)) / 4.25
    # Both ways 0.5 dB/(cm MHz) x 3.3 MHz.
    assert levels[260] - levels[130] == pytest.approx(2 * 0.5 * 3.3 * 130 * 0.0308, abs=0.3)


def sweep_frames(renderer, needle, shift, direction):
    X_TP = still(renderer)
    X_TP[:, 0, 3] += shift * np.arange(27)
    return Frames(slice(0, 27), direction, X_TP, np.zeros(27), [needle] * 27)


def render(renderer, frames):
    return renderer.render(frames.X_TP, frames.needles, frames.direction, 5)


@pytest.mark.parametrize("direction", [1, -1])
def test_frames_begun_in_the_background_are_the_same_and_rendered_once(direction, monkeypatch):
    rendered = []
    original = FrameRenderer.grey_levels

    def grey_levels(self, iq, frames, number):
        rendered.append(frames.part.start)
        return original(self, iq, frames, number)

    monkeypatch.setattr(FrameRenderer, "grey_levels", grey_levels)
    needle = needle_through([0, 0, -0.15], 0.3, 0.0)
    renderer = make_renderer(sector=0.2)
    frames = sweep_frames(renderer, needle, 1e-5, direction)
    expected = render(renderer, frames)
    groups = renderer.groups(direction)
    rendered.clear()
    for part in groups[:-1]:
        renderer.begin(frames.among(part), 5)
    assert (render(renderer, frames) == expected).all()
    assert sorted(rendered) == sorted(part.start for part in groups)


@pytest.mark.parametrize("changed", ["pose", "needle", "number"])
def test_frames_begun_for_another_sweep_are_not_used(changed):
    renderer = make_renderer(sector=0.2)
    needle = needle_through([0, 0, -0.15], 0.3, 0.0)
    frames = sweep_frames(renderer, needle, 0.0, 1)
    expected = render(renderer, frames)
    other = {
        "pose": sweep_frames(renderer, needle, 1e-4, 1),
        "needle": sweep_frames(renderer, needle_through([0, 0, -0.14], 0.3, 0.0), 0.0, 1),
        "number": frames,
    }[changed]
    for part in renderer.groups(1):
        renderer.begin(other.among(part), 4 if changed == "number" else 5)
    assert (render(renderer, frames) == expected).all()


def test_what_is_kept_of_a_needle_at_rest_does_not_show():
    """Each sweep is that of a renderer that has not seen the ones before; fading changes it."""
    lying = needle_through([-0.038, -0.012, -0.15], 0.3, 0.0)  # its tip is in the middle
    withdrawn = replace(lying, shaft=lying.shaft - [0.004, 0, 0])
    echo = NeedleEchoParameters(tip="bevel", fading_db=3.0)
    few = {"sector": 0.2, "frames": 5}
    renderer = make_renderer(needle=echo, track_db=0.0, **few)
    sweeps = [
        (lying, 0.0),
        (lying, 0.0),
        (lying, 2.0),
        (replace(lying, roll=2.0), 2.0),
        (replace(lying, radius=0.4e-3), 2.0),
        (withdrawn, 2.0),
        (replace(withdrawn, track=np.stack([withdrawn.tip, lying.tip])), 2.0),
        (NOWHERE, 2.0),
    ]
    shown = []
    for needle, time in sweeps:
        arguments = still(renderer), [needle] * 5, 1, 0, np.full(5, time)
        fresh = make_renderer(needle=echo, track_db=0.0, **few)
        shown.append(renderer.render(*arguments))
        assert (shown[-1] == fresh.render(*arguments)).all()
    assert [bool((a != b).any()) for a, b in pairwise(shown)] == [False, *[True] * 6]


# Lengths, and poses of a face 1 mm above the apex: X_P along Y_T on a limb, along X_T on a ball.
RADIUS = 0.06
BODIES = {
    "cylinder": (0.3, [[0, 0, 1, 0], [1, 0, 0, 0], [0, -1, 0, 1e-3], [0, 0, 0, 1.0]]),
    "ellipsoid": (2 * RADIUS, [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 1e-3], [0, 0, 0, 1.0]]),
}
FEW = {"frames": 3, "volume_rate": 10.0, "frame_pitch_deg": 0.1}


@pytest.fixture(params=BODIES)
def curved(request):
    length, X_TP = BODIES[request.param]
    size = [length, 2 * RADIUS, 2 * RADIUS]
    return Tissue(size=size, shape=request.param, seed=1), np.array(X_TP)


def first_paths(renderer):
    """The way along each line of the middle frame from the face to the body, in closed form."""
    geometry = renderer.geometry
    middle = geometry.frames // 2
    angles = geometry.line_pitch * (np.arange(geometry.lines) - (geometry.lines - 1) / 2)
    # In the plane across it, with the origin on its axis.
    height = RADIUS + 1e-3 + geometry.array_radius * (1 - np.cos(angles))
    origin = np.stack([geometry.array_radius * np.sin(angles), height])
    along = np.stack([np.sin(angles), -np.cos(angles)])
    b = (origin * along).sum(axis=0)
    root = b**2 - (origin**2).sum(axis=0) + RADIUS**2
    return middle, np.where(root > 0, -b - np.sqrt(np.maximum(root, 0)), np.inf)


def test_echoes_begin_at_the_curved_skin(curved):
    tissue, X_TP = curved
    renderer = make_renderer(tissue, **FEW)
    middle, paths = first_paths(renderer)
    envelope = np.abs(renderer.tissue_echo(still(renderer, X_TP), 1)[middle])
    depths = renderer.geometry.sample_pitch * np.arange(renderer.geometry.samples)
    lines = slice(10, -10, 5)  # the beam is wider than a line
    seen = [float(depths[np.argmax(line > 0.3)]) for line in envelope[lines]]
    off = np.array(seen) - paths[lines]
    assert np.abs(np.median(off)) < 0.8e-3  # of the pulse
    assert np.abs(off).max() < 2.5e-3
    assert np.ptp(paths[lines]) > 5e-3


def test_only_lines_that_the_gel_reaches_are_coupled(curved):
    tissue, X_TP = curved
    renderer = make_renderer(tissue, **FEW, sector=1.0)
    middle, paths = first_paths(renderer)
    grey = renderer.render(still(renderer, X_TP), [NOWHERE] * 3, 1, 0)[middle].astype(float)
    level = grey[:, 60:160].mean(axis=1)
    assert (level[paths < 3e-3] > 60).all()
    assert (level[paths > 3.7e-3] < 30).all()
    assert (paths < 3e-3).any()
    assert (paths > 3.7e-3).any()


def test_a_curved_body_takes_no_layers_of_a_box():
    with pytest.raises(ValueError, match="shape: 'ellipsoid' .* box with a layer of fat"):
        Tissue(shape="ellipsoid", fat=FatLayer(thickness=0.01))
    with pytest.raises(ValueError, match="shape: 'egg'"):
        Tissue(shape="egg")


def test_nothing_echoes_outside_the_phantom():
    renderer = make_renderer(Tissue(size=[0.24, 0.16, 0.05]), sector=0.3, frames=9)
    pose = DOWN.copy()
    pose[2, 3] = -0.004
    echo = np.abs(renderer.tissue_echo(still(renderer, pose), 1))
    geometry = renderer.geometry
    y = geometry.position(*np.ogrid[: geometry.frames, : geometry.lines, : geometry.samples], 1)
    depth = y[..., 1] - 0.004 + 0.008  # below the top
    assert echo[depth > 0.054].max() == 0
    assert echo[(depth > 0.01) & (depth < 0.045)].mean() == pytest.approx(0.87, abs=0.05)
