"""The same scenario and seed give the same bits on every processor."""

import importlib
import json
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from sonoservo import systems
from sonoservo.systems.sampling.kernels import chosen_ties

DIGESTS = Path(__file__).parent / "helpers" / "digests.py"


def test_no_kernel_may_round_as_it_likes():
    freedoms = {}
    for module in pkgutil.walk_packages(systems.__path__, f"{systems.__name__}."):
        for each in vars(importlib.import_module(module.name)).values():
            if isinstance(each, Dispatcher):
                freedoms[each.py_func] = each.targetoptions.get("fastmath", False)
    assert len(freedoms) > 80
    assert not [kernel for kernel, freedom in freedoms.items() if freedom]


def test_ties_are_scattered_and_one_less_changes_no_other():
    shape = (40, 50, 60)
    voxels = np.arange(np.prod(shape))
    chosen = chosen_ties(voxels, 6000)
    places = (np.stack(np.unravel_index(chosen, shape), axis=1) + 0.5) / shape
    np.testing.assert_allclose(places.mean(axis=0), 0.5, atol=0.015)  # 4 standard errors
    eighths = np.histogramdd(places, [(0, 0.5, 1)] * 3)[0]
    np.testing.assert_allclose(eighths, 750, atol=110)
    assert len(chosen) == 6000
    others = np.delete(voxels, chosen[::100])
    assert set(chosen) - set(chosen[::100]) <= set(chosen_ties(others, 6000))
    assert len(chosen_ties(voxels[:5], 7)) == 5
    assert len(chosen_ties(voxels, 0)) == 0


@pytest.mark.slow
@pytest.mark.parametrize("processor", ["x86-64-v3", "x86-64-v2"])
def test_volumes_and_estimates_are_the_same_on_another_processor(processor, tmp_path):
    """Volumes are rendered, and the needle is found and tracked, in two processes."""
    other = {"NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": tmp_path}
    native, theirs = (
        json.loads(
            subprocess.run(
                [sys.executable, DIGESTS, "20"],
                env=os.environ | environment,
                stdout=subprocess.PIPE,
                check=True,
            ).stdout
        )
        for environment in ({}, other)
    )
    assert theirs == native
    assert "tracking" in (mode for *_, mode in native["chatelain2013_fig5"])
