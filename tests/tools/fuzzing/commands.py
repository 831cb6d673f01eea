"""Fuzzer of command lines: values of options and arguments that nobody meant."""

import contextlib
import io
from pathlib import Path
from random import Random

from fuzzing.engine import Outcome
from fuzzing.files import bases
from fuzzing.mutations import NUMBERS, WORDS
from sonoservo.diagrams.app.cli import run_arguments
from sonoservo.systems.files.refusals import MAX_MESSAGE

_SHORT = ["--set", "duration=0.3", "--no-meshcat"]
_COMMANDS = {
    "run": (["run", "chatelain2013_fig5", *_SHORT], ["--set", "--seed", "--record", "--serve"]),
    "scan": (["scan"], ["--phantom", "--time", "--set", "--seed"]),
    "track": (["track", "FILE"], [
        "--tracker", "--order", "--start", "--depth", "--window", "--dynamic-range-db",
        "--volume-rate", "--poses", "--seed", "--frames", "--spacing", "--reconstruct",
    ]),
    "locate": (["locate", "FILE"],
               ["--number", "--order", "--depth", "--window", "--dynamic-range-db"]),
    "explain": (["explain", "FILE"], ["--time"]),
    "dataset": (["dataset", "chatelain2013_fig5", "--jobs", "1"],
                ["--count", "--volumes", "--probe", "--seed", "--jobs", "--set"]),
    "reproduce": (["reproduce"], ["--seeds", "--first-seed", "--jobs"]),
    "list": (["list"], []),
}  # fmt: skip
_REFUSED = {"run": 0.4, "dataset": 1.0, "reproduce": 1.0}
"""Probability that a command that takes long gets an option that nobody has."""


def command_case(number: int, folder: Path, seed: int = 0) -> Outcome:
    """Run a command with odd values in this process."""
    rng = Random(f"commands {seed} {number}")
    name = rng.choice(sorted(_COMMANDS))
    arguments, options = _COMMANDS[name]
    files, opened, _ = bases()[rng.choice(["raw nrrd", "recorded", "frames", "mha"])]
    for each, content in files.items():
        (folder / each).write_bytes(content)
    arguments = [str(folder / opened) if each == "FILE" else each for each in arguments]
    for _ in range(rng.choice([1, 1, 2])):
        option = rng.choice([*options, "--json", "--out", "--max-memory"])
        arguments.append(option)
        if option != "--reconstruct":
            arguments += [_value(rng, folder) for _ in range(2 if option == "--window" else 1)]
    if rng.random() < _REFUSED.get(name, 0.05):
        arguments.append(rng.choice(["--no-such-option", "extra", "--seed=x", "--out"]))
    if "--out" not in arguments and name in ("run", "scan", "track"):
        arguments += ["--out", str(folder / "out")]
    output = io.StringIO()
    with contextlib.redirect_stderr(output), contextlib.chdir(folder):
        code = run_arguments(arguments)
    said = output.getvalue().strip()
    lines = [line for line in said.splitlines() if line.startswith("sonoservo: ")]
    fault = code not in (0, 1, 2) or "Traceback" in said or (code == 2 and len(lines) != 1)
    fault = fault or any(len(line) > MAX_MESSAGE + len("sonoservo: ") for line in lines)
    result = "bug" if fault else "refused" if code == 2 else "good"
    return Outcome(f"{arguments}"[:600], result, f"exit code {code}: {said[-600:]}")


def _value(rng: Random, folder: Path) -> str:
    words = [*NUMBERS, *WORDS, "a=b", "seed=-1", "imaging=3", str(folder), "x.seq.nrrd", "3", "2"]
    return rng.choice(words).replace("\0", "\1")
