"""Cases for clusters: they calculate, run an experiment, hang, or end their process."""

import os
import time
from pathlib import Path

import numpy as np

from sonoservo.diagrams.studies import WithFiles


def calculate(case):
    """Return numbers that any difference of threads or versions would change."""
    if case.seed == case.settings.get("raises"):
        raise ValueError("no luck")
    a = np.random.default_rng(case.seed).normal(size=(60, 60))
    values = np.linalg.eigvalsh(a @ a.T)
    threads = {os.environ[name] for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")}
    return WithFiles(
        {"values": values, "nothing": float("nan"), "threads": sorted(threads)},
        {f"case_{case.seed}/values.bin": values.tobytes()},
    )


def report(case):
    """Leave the numbers of the worker's process and of its nanny in a file."""
    folder = Path(case.settings["folder"])
    partial = folder / f".{case.seed}_{os.getpid()}"
    partial.write_text(f"{os.getpid()} {os.getppid()}")
    partial.rename(folder / f"{case.seed}_{os.getpid()}")
    return len(list(folder.glob(f"{case.seed}_*")))


def wait_once(case):
    """Wait for ever the first time, and return the number of the attempt after that."""
    number = report(case)
    if number == 1:
        time.sleep(600)
    return {"attempt": number}


def count(case):
    """Report, and return; all but the first wait while there is a file "wait"."""
    report(case)
    while case.seed and (Path(case.settings["folder"]) / "wait").exists():
        time.sleep(0.1)
    return {"seed": case.seed}


def end_process(case):
    """End the process of one of the cases."""
    report(case)
    if case.settings.get("poison"):
        os._exit(1)
    return {}


def run_short(case):
    """Run an experiment over a small sector for as long as the case says; a small result."""
    from sonoservo.diagrams.experiments.registry import load_scenario, make_experiment

    changes = [
        f"duration={case.settings['duration']}",
        "imaging.sector=0.3",
        "imaging.depth=0.06",
        "station.plant.contact_model=point",
    ]
    experiment = make_experiment(
        load_scenario("chatelain2013_fig5", seed=case.seed, changes=changes)
    )
    experiment.run()
    return {"last": experiment.log().time[-1]}
