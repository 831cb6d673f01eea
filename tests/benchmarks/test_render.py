"""Rendering of paper-sized sweeps. A sweep at 3.3 volumes a second takes 303 ms to acquire."""

import numpy as np
import pytest

from sonoservo.systems.needle.needle import Needle
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.rendering import ScannerParameters, SweepRenderer
from sonoservo.systems.ultrasound.tissue import load_tissue
from sonoservo.systems.ultrasound.transducer import Transducer

SIZES = {
    "27 x 96 x 293": ImagingParameters(),
    "31 x 128 x 480": ImagingParameters(depth=0.1476, sector=1.0, frames=31, volume_rate=1.3),
}


@pytest.mark.parametrize("still", [False, True], ids=["probe moves", "probe still"])
@pytest.mark.parametrize("size", SIZES)
def test_render(benchmark, size, still):
    imaging = SIZES[size]
    renderer = SweepRenderer(
        transducer=Transducer(),
        imaging=imaging,
        tissue=load_tissue("agar"),
        parameters=ScannerParameters(),
        seed=0,
    )
    frames = renderer.geometry.frames
    assert size == " x ".join(str(extent) for extent in renderer.geometry.shape)
    needle = Needle(np.array([[-0.06, 0.01, -0.045], [0.02, 0.0, -0.045]]), 0.635e-3)
    X_TP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, -0.004], [0, 0, 0, 1.0]])
    poses = np.repeat(X_TP[np.newaxis], frames, axis=0)
    number = 0

    def render():
        nonlocal number
        number += 1
        if not still:
            poses[:, 0, 3] += 1e-6
        return renderer.render(poses, [needle] * frames, 1, number)

    render()
    grey = benchmark(render)
    assert grey.mean() > 30
    sweep_ms = 1e3 * renderer.geometry.period
    benchmark.extra_info["compared_with"] = "the time the sweep takes to acquire"
    benchmark.extra_info["acquisition_ms"] = sweep_ms
    if benchmark.stats is not None:
        benchmark.extra_info["ratio"] = sweep_ms / (1e3 * benchmark.stats.stats.median)
