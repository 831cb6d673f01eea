"""Compilation of the numeric kernels, so that the first run starts at once.

Only the processes that compile load what they run, which takes some seconds.
"""

import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from multiprocessing import get_context
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sonoservo.systems.signals.volume import Volume

_SPACING = 1e-3
_SHAPE = (80, 60, 40)
_VOLUMES, _BEFORE = 16, 7
_SILENCE = 30.0  # Longest time in s without a line about the progress
_ADVANCE = 3  # Advance of the needle from one synthetic volume to the next, in voxels


def compile_scanner() -> None:
    """Compile rendering, scan conversion and pictures: simulate two sweeps and keep the results."""
    changes = [
        "duration=1.3",
        "hand.start=0",
        "hand.pushes.0.speed=0.05",
        "station.plant.contact_model=point",
    ]
    _run("chatelain2013_fig5", changes)


def compile_tracker() -> None:
    """Compile detection and localization: track a line that grows in noise, straight and bent."""
    from sonoservo.diagrams.tracker_bench import track
    from sonoservo.diagrams.trackers.chatelain2013 import Chatelain2013TrackerParameters

    volumes = list(_volumes())
    for order in (2, 3):
        list(track(volumes, parameters=Chatelain2013TrackerParameters(order=order)))
    everywhere = Chatelain2013TrackerParameters(start="anywhere")
    list(track(volumes[-2:], parameters=everywhere))


def compile_shape_prediction() -> None:
    """Compile slices, template matching and particle filter: insert a bevelled needle."""
    _run("carriere2016_d60", ["depth=0.07"])


def compile_harder_world() -> None:
    """Compile structures, tissue that reacts and errors of instruments: simulate two sweeps."""
    _run("clinic", ["duration=1.3", "hand.start=0"])


TASKS: tuple[Callable[[], None], ...] = (compile_scanner, compile_tracker)
"""What a run of following in a clean world needs, such as that of ``make run``."""

MORE_TASKS: tuple[Callable[[], None], ...] = (compile_shape_prediction, compile_harder_world)
"""What other scenarios need besides; they compile it themselves when it is first needed."""


def compile_kernels(*, everything: bool = False) -> Iterator[str]:
    """Compile the kernels of runs and trackers, two at a time, and yield lines on the progress."""
    start = time.perf_counter()
    # Two, as they take turns in keeping the compiler busy; each takes some hundred MB.
    processes = min(2, os.cpu_count() or 1)
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        wanted = (*TASKS, *MORE_TASKS) if everything else TASKS
        names = [task.__name__.removeprefix("compile_").replace("_", " ") for task in wanted]
        left = {pool.submit(task): name for task, name in zip(wanted, names, strict=True)}
        while left:
            finished = wait(left, _SILENCE, FIRST_COMPLETED).done
            after = f"after {time.perf_counter() - start:.0f} s"
            for done in finished:
                done.result()
                yield f"{left.pop(done)}: ready {after}"
            if not finished:
                yield f"{', '.join(left.values())}: still compiling {after}"


def _run(scenario: str, changes: list[str]) -> None:
    from sonoservo.diagrams.app.run import run
    from sonoservo.diagrams.experiments.registry import load_scenario

    with TemporaryDirectory() as folder:  # with results, there are pictures
        run(load_scenario(scenario, changes=changes), out=folder)


def _volumes() -> Iterator["Volume"]:
    """Yield volumes in which a bright line grows from the side, and another one rests.

    Two, because arrays of a single line are contiguous, for which Numba compiles other kernels.
    """
    import numpy as np
    from pydrake.math import RigidTransform

    from sonoservo.systems.signals.volume import Volume

    rng = np.random.default_rng(0)
    tissue = rng.rayleigh(20, _SHAPE)
    for number in range(_VOLUMES):
        intensities = np.clip(tissue + rng.normal(0, 1, _SHAPE), 1, 255)
        length = max(0, _ADVANCE * (number - _BEFORE))
        intensities[:length, 29:31, 19:21] = 230
        intensities[20:60, 44:46, 29:31] = 230
        yield Volume(
            intensities=intensities.astype(np.uint8),
            origin=np.array([-40e-3, 0, -20e-3]),
            spacing=np.full(3, _SPACING),
            X_WP=RigidTransform(),
            time=0.3 * number,
        )
