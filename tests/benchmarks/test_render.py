"""Rendering of whole sweeps against the time that they take to acquire."""

import numpy as np
import pytest

from sonoservo.diagrams.papers.zhao2012.phantom import IMAGING as ZHAO
from sonoservo.systems.signals import Needle
from sonoservo.systems.ultrasound import ImagingParameters, load_transducer
from sonoservo.systems.ultrasound.simulation import ScannerParameters, SweepRenderer, load_tissue

LARGE = ImagingParameters(depth=0.1476, sector=1.0, frames=31, volume_rate=1.3)
SIZES = {
    "27 x 96 x 293": ("4dc7_3_40", ImagingParameters()),
    "31 x 128 x 480": ("4dc7_3_40", LARGE),
    "53 x 71 x 2608": ("zhao2012", ZHAO),
}
NEEDLE = Needle(np.array([[-0.06, 0.01, -0.045], [0.02, 0.0, -0.045]]), 0.635e-3)
DOWN = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, -0.004], [0, 0, 0, 1.0]])


@pytest.mark.parametrize("size", SIZES)
def test_render_while_the_probe_moves(benchmark, size):
    transducer, imaging = SIZES[size]
    renderer = SweepRenderer(
        transducer=load_transducer(transducer),
        imaging=imaging,
        tissue=load_tissue("agar"),
        parameters=ScannerParameters(),
        seed=0,
    )
    assert size == " x ".join(str(extent) for extent in renderer.geometry.shape)
    frames = renderer.geometry.frames
    poses = np.repeat(DOWN[np.newaxis], frames, axis=0)

    def render():
        poses[:, 0, 3] += 1e-6
        return renderer.render(poses, [NEEDLE] * frames, 1, 0)

    assert benchmark(render).mean() > 15
    benchmark.extra_info["compared_with"] = "the time the sweep takes to acquire"
    if benchmark.stats is not None:
        benchmark.extra_info["ratio"] = renderer.geometry.period / benchmark.stats.stats.median
