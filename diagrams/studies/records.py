"""Kept records of a study: a small one for each run, from which its tables are made again."""

import gzip
import json
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sonoservo.diagrams.studies.fingerprint import code_fingerprint, is_outdated
from sonoservo.diagrams.studies.study import Case, Outcome
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.writing import write_atomically

_DIGITS = 6  # significant digits of the figures that are kept


@dataclass(frozen=True)
class Records:
    """Records of the runs of a study, with the command, commit and version that made them.

    Each of `repeats` says that some of the runs, made again, gave the same: the `code` by module,
    the processor it was compiled `for`, the `commit`, and the number of `runs`.
    """

    command: str
    commit: str
    version: str
    outcomes: Sequence[Outcome]
    repeats: Sequence[Mapping[str, Any]] = ()

    @property
    def present_repeats(self) -> list[Mapping[str, Any]]:
        """The repeats that the present code made."""
        return [each for each in self.repeats if each["code"] == present_code(each["code"])]

    @property
    def is_outdated(self) -> bool:
        """Whether the code of any has changed since, and none was made again by the present one."""
        identities = {json.dumps(dict(each.made_by), sort_keys=True) for each in self.outcomes}
        changed = any(is_outdated(json.loads(each)) for each in identities)
        return changed and not self.present_repeats


def present_code(modules: Iterable[str]) -> dict[str, str]:
    """Return the present fingerprints of the code of some modules."""
    return {each: code_fingerprint(each) for each in modules}


def present_records(
    outcomes: Sequence[Outcome], command: str, repeats: Sequence[Mapping[str, Any]] = ()
) -> Records:
    """Return the records of runs that the present code, which must be committed, made or repeats.

    ConfigurationError if other code made any, and the present one repeated none.
    """
    records = Records(command, kept_commit(), version("sonoservo"), outcomes, repeats)
    if records.is_outdated:
        raise ConfigurationError("--keep: other code than the present one made some of the runs")
    return records


def write_records(path: Path, kept: Records) -> None:
    """Write records to one compressed file."""
    identities: list[Mapping[str, str]] = []
    records = []
    for each in kept.outcomes:
        record = {key: value for key, value in asdict(each).items() if key != "files"}
        if each.made_by not in identities:
            identities.append(each.made_by)
        records.append(_rounded(record) | {"made_by": identities.index(each.made_by)})
    content = {
        "command": kept.command,
        "commit": kept.commit,
        "version": kept.version,
        "made_by": [dict(each) for each in identities],
        "records": records,
        "repeats": kept.repeats,
    }
    text = json.dumps(content, separators=(",", ":"))
    write_atomically(path, gzip.compress(text.encode(), mtime=0))


def read_records(path: Path) -> Records | None:
    """Read the records of a study; None if there is no such file."""
    if not path.is_file():
        return None
    with refusing_failures(path, "not records of a study, or damaged"):
        content = json.loads(gzip.decompress(path.read_bytes()))
        outcomes = [
            Outcome(
                **each
                | {"case": Case(**each["case"]), "made_by": content["made_by"][each["made_by"]]}
            )
            for each in content["records"]
        ]
        command, commit, made = (content[each] for each in ("command", "commit", "version"))
        return Records(command, commit, made, outcomes, content.get("repeats", ()))


def _rounded(value: Any) -> Any:
    """Return a value of JSON with its numbers rounded to the digits that are kept."""
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}")
    if isinstance(value, Mapping):
        return {key: _rounded(each) for key, each in value.items()}
    return [_rounded(each) for each in value] if isinstance(value, list | tuple) else value


def kept_commit() -> str:
    """Return the program's commit; ConfigurationError if the present code is not committed."""
    commit = present_commit()
    if commit.endswith("+"):
        raise ConfigurationError(f"--keep: the code of {commit} was not committed")
    return commit


def present_commit() -> str:
    """Return the program's commit, with "+" if tracked files differ; "unknown" without git."""
    folder = Path(__file__).resolve().parent
    try:
        commit, changes = (
            subprocess.run(
                ["git", "-C", str(folder), *arguments],
                capture_output=True,
                text=True,
                check=True,
                timeout=10,
            ).stdout.strip()
            for arguments in (("rev-parse", "HEAD"), ("status", "--porcelain", "-uno"))
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return commit + "+" if changes else commit
