"""Suites of the benchmark, as data, and the seeds of their sequences."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

from sonoservo.diagrams.studies.robustness.graded_dials import PLAIN
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import read_yaml, suggest
from sonoservo.systems.signals.requirements import require

VERSION = 1  # version of the suites; another one means that scores do not compare
SEQUENCES = 20  # number of sequences in a suite
_SALTED = 1000  # distance of the seeds of one salt from those of the next


@dataclass(frozen=True)
class Suite:
    """One difficulty of the benchmark.

    Parameters
    ----------
    line
        Description for a person.
    scenario
        Scenario that it changes; for fig. 5 of Chatelain 2013, the changes `PLAIN` come first.
    changes
        Assignments in the scenario.
    phantom, phantom_changes
        Phantom that replaces the scenario's, and fields of its file.
    """

    line: str
    scenario: str = "chatelain2013_fig5"
    changes: Sequence[str] = ()
    phantom: str = ""
    phantom_changes: Mapping[str, Any] = field(default_factory=dict)

    def settings(self) -> dict[str, Any]:
        """Return the settings of a case of this suite; see `scenario_of`."""
        plain = () if self.scenario == "clinic" else (*PLAIN, "hand.start=2.0")
        return {
            "scenario": self.scenario,
            "changes": [*plain, *self.changes],
            "phantom": self.phantom,
            "phantom_changes": dict(self.phantom_changes),
        }


def load_suites(names: Sequence[str] = ()) -> dict[str, Suite]:
    """Return suites by name; all of them if none is named."""
    path = Path(str(files("sonoservo.diagrams.benchmark"))) / "suites.yaml"
    known = {name: Suite(**each) for name, each in read_yaml(path).items()}
    for name in names:
        if name not in known:
            raise ConfigurationError(f"unknown suite {name!r}; {suggest(name, known)}")
    return {name: suite for name, suite in known.items() if not names or name in names}


def sequence_seeds(salt: int = 0, count: int = SEQUENCES) -> range:
    """Return the seeds of a suite's sequences: 0 and up, or 1000 times the salt and up."""
    require(salt >= 0, "salt", salt, "0 or more")
    require(1 <= count <= SEQUENCES, "sequences", count, f"from 1 to {SEQUENCES}")
    return range(_SALTED * salt, _SALTED * salt + count)
