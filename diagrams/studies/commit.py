"""Commit of the repository from which the program runs."""

import subprocess
from pathlib import Path


def present_commit() -> str:
    """Return the commit of the checkout the program runs from, or "unknown" outside of one.

    A plus sign is added if tracked files differ from the commit.
    """
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
