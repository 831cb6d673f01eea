"""Figures of the benchmarks, and what rendering a sweep costs against its size and density.

python tests/benchmarks/plot_cost.py out/bench.json out/render_cost.png
"""

import json
import sys
from math import prod
from pathlib import Path

from matplotlib.figure import Figure
from rich.console import Console
from rich.markup import escape
from rich.table import Table


def milliseconds(benchmarks, function):
    """Medians by parameters of one benchmark function."""
    return {
        tuple(each["params"].values()): 1e3 * each["stats"]["median"]
        for each in benchmarks
        if each["name"].startswith(function + "[")
    }


def print_table(benchmarks):
    """Print one table: cost, what it is compared with, and how much longer that takes."""
    table = Table("benchmark", "ms", "compared with", "takes times as long", "figures")
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
        table.add_row(escape(each["name"]), f"{ms:.4g}", peer, shown, ", ".join(rest))
    Console(width=200).print(table)


def main(source, target):
    benchmarks = json.loads(Path(source).read_text())["benchmarks"]
    print_table(benchmarks)
    cost = milliseconds(benchmarks, "test_render")
    if not cost:
        return
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    by_size, by_density = figure.subplots(1, 2)
    for state, moves in (("probe moves", True), ("probe still", False)):
        points = sorted(
            (prod(int(extent) for extent in size.split(" x ")) / 1e6, ms, size)
            for (size, speed), ms in cost.items()
            if (speed > 0) == moves
        )
        by_size.loglog(*zip(*[point[:2] for point in points], strict=True), "o-", label=state)
    ticks = [f"{samples:.2g}\n{size}" for samples, _, size in points]
    by_size.set_xticks([samples for samples, _, _ in points], ticks, fontsize=8)
    by_size.minorticks_off()
    by_size.legend()
    by_size.set(xlabel="samples in a sweep / million", ylabel="ms a sweep", title="Size")
    densities = milliseconds(benchmarks, "test_render_denser_tissue")
    by_density.plot(*zip(*sorted((k[0], ms) for k, ms in densities.items()), strict=True), "o-")
    by_density.set(
        xlabel="scatterers in a resolution cell", title="Density (31 x 128 x 480)", ylim=(0, None)
    )
    for axes in (by_size, by_density):
        axes.grid(alpha=0.3, which="both")
    figure.savefig(target, dpi=120)


if __name__ == "__main__":
    main(*sys.argv[1:])
