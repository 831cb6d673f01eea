"""Order of files by name, as people count."""

import re
from collections.abc import Iterable
from pathlib import Path


def natural_order(files: Iterable[Path]) -> list[Path]:
    """Return files in the order of their names, 9 before 10."""
    return sorted(
        files,
        key=lambda each: [int(n) if n.isdecimal() else n for n in re.split(r"(\d+)", each.name)],
    )
