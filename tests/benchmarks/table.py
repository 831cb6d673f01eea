"""Table of the benchmarks: python tests/benchmarks/table.py out/bench.json."""

import json
from argparse import ArgumentParser
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table


def print_table(benchmarks):
    """Print one table: cost, what it is compared with, and how much longer that takes."""
    table = Table("benchmark", "ms", "compared with", "which takes times as long", "figures")
    for each in benchmarks:
        figures = dict(each["extra_info"])
        ms = figures.pop("ms", 1e3 * each["stats"]["median"])
        peer, ratio = figures.pop("compared_with", ""), figures.pop("ratio", None)
        rest = [
            f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in figures.items()
            if isinstance(value, float | int | str)
        ]
        shown = "" if ratio is None else f"{ratio:.3g}"
        name = each["name"].removeprefix("test_").replace("_", " ")
        table.add_row(escape(name), f"{ms:.4g}", peer, shown, ", ".join(rest))
    Console(width=200).print(table)


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("path", type=Path, help="figures that pytest-benchmark wrote")
    print_table(json.loads(parser.parse_args().path.read_text())["benchmarks"])
