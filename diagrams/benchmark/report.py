"""Files of the benchmark: JSON, a Markdown table, and a page with the worst cases as pictures."""

import html
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from sonoservo.diagrams.benchmark.benchmark import ALL, BenchmarkResult, summarize
from sonoservo.diagrams.benchmark.entrants import sequence_name
from sonoservo.diagrams.benchmark.scores import BINS, FIGURES
from sonoservo.diagrams.benchmark.sequence import load_suites
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.diagrams.studies.study_report import interval_text
from sonoservo.systems.evaluation.reports.plots import png
from sonoservo.systems.evaluation.reports.report import picture, web_page
from sonoservo.systems.evaluation.table import Table, cell_text
from sonoservo.systems.files.writing import write_atomically, write_json

_WORST = 4  # number of a tracker's worst sequences that the page shows

_SHARES = (
    "Share of needles among estimates of a stated probability, with 95 % intervals that take the "
    "volumes for independent."
)


def write_benchmark(result: BenchmarkResult, folder: Path, command: str) -> None:
    """Write benchmark.json, benchmark.md and report.html, with the command that repeats it."""
    data = result.data
    write_json(folder / "benchmark.json", data)
    write_atomically(folder / "benchmark.md", benchmark_markdown(data))
    write_atomically(folder / "report.html", _page(result, folder, command))


def benchmark_table(data: Mapping[str, Any], tracker: str = "") -> Table:
    """Return scores over all suites by tracker, in columns, or of one tracker by suite, in rows."""
    scored = {name: each for name, each in data["scores"].items() if ALL in each}
    rows = scored[tracker] if tracker else {name: each[ALL] for name, each in scored.items()}
    table = Table(
        ["suite" if tracker else "tracker", *FIGURES.values()],
        [[name, *(row[each]["text"] for each in FIGURES)] for name, row in rows.items()],
    )
    return table if tracker else table.transposed()


def benchmark_markdown(data: Mapping[str, Any]) -> str:
    """Return the scores as Markdown: all trackers over all suites, then each by suite, folded."""
    lines = [f"Version {data['version']}, salt {data['salt']}, {data['sequences']} sequences, "
             f"{len(data['failed'])} failed. In brackets: 95 % intervals.", ""]  # fmt: skip
    lines.append(benchmark_table(data).markdown())
    if any(data["reliability"].values()):
        lines += ["", "## Stated probability", "", _SHARES, ""]
        lines.append(reliability_table(data).markdown())
    for name in data["scores"]:
        if data["scores"][name]:
            summary = f"<summary>{html.escape(name)}, by suite</summary>"
            lines += ["", "<details>", summary, "", benchmark_table(data, name).markdown(), ""]
            lines.append("</details>")
    return "\n".join(lines) + "\n"


def reliability_table(data: Mapping[str, Any]) -> Table:
    """Return the share of needles among estimates of a stated probability, by tracker."""
    curves = {
        name: {each["from"]: each for each in points}
        for name, points in data["reliability"].items()
        if points
    }
    rows = [
        [f"{low:g} to {high:g}", *(_share(points.get(low)) for points in curves.values())]
        for low, high in pairwise(BINS)
    ]
    return Table(["stated probability", *curves], rows)


def _share(point: Mapping[str, Any] | None) -> str:
    if point is None:
        return ""
    share, low, high = (100 * point[key] for key in ("share", "low", "high"))
    return f"{cell_text(share)} % ({interval_text(low, high)}) of {point['volumes']}"


def kept_markdown(outcomes: Sequence[Outcome]) -> str:
    """Return the scores in kept records as Markdown."""
    return benchmark_markdown(summarize(outcomes))


def _page(result: BenchmarkResult, folder: Path, command: str) -> str:
    data = result.data
    body = [f"<h2>All suites</h2>{benchmark_table(data).html()}"]
    for name, each in data["scores"].items():
        if each:
            table = benchmark_table(data, name).html()
            body.append(f"<h2>{html.escape(name)}</h2>{table}<h3>Worst cases</h3>")
            body += [_worst(folder, name, *case) for case in worst_cases(data, name)]
    body += [
        f"<p>{html.escape(each['suite'])}, seed {each['seed']}: {html.escape(each['error'])}</p>"
        for each in data["failed"]
    ]
    body += [
        f"<p><b>{html.escape(name)}</b>: {html.escape(each.line)}.</p>"
        for name, each in load_suites().items()
    ]
    caption = f"{_SHARES} On the dashed line, the stated probability is right."
    figures = {caption: png(plot_reliability(data["reliability"]))}
    facts = (
        f"Sequences: {data['sequences']}, salt: {data['salt']}. <code>{html.escape(command)}</code>"
    )
    return web_page("Benchmark of needle trackers", facts, "\n".join(body), figures)


def worst_cases(data: Mapping[str, Any], tracker: str) -> list[tuple[str, int]]:
    """Return suite and seed of a tracker's worst sequences: the fewest volumes tracked right."""

    def badness(record: Mapping[str, Any]) -> float:
        own = record[tracker]
        wrong = sum(each is None for each in own["tip_mm"])
        return own["false_finds"] + wrong / max(len(own["tip_mm"]), 1)

    ordered = sorted(data["records"], key=badness, reverse=True)
    return [(each["suite"], each["seed"]) for each in ordered[:_WORST] if badness(each) > 0]


def _worst(folder: Path, tracker: str, suite: str, seed: int) -> str:
    path = folder / "cases" / tracker / f"{sequence_name(suite, seed)}.png"
    if not path.is_file():
        return ""
    said = f"{suite}, seed {seed}: cut along the estimate (left), and along the true needle (right)"
    return picture(said, path.read_bytes())


def plot_reliability(curves: Mapping[str, Any]) -> Figure:
    """Return the reliability curves of trackers that state a probability."""
    figure = Figure(figsize=(5, 4.5), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.6", linestyle="--", linewidth=1)
    for name, points in curves.items():
        if points:
            share = [each["share"] for each in points]
            ends = [[s - each["low"] for s, each in zip(share, points, strict=True)],
                    [each["high"] - s for s, each in zip(share, points, strict=True)]]  # fmt: skip
            axes.errorbar([each["stated"] for each in points], share, ends, marker="o",
                          capsize=3, label=name)  # fmt: skip
    axes.set_xlabel("stated probability")
    axes.set_ylabel("share of needles")
    if any(curves.values()):
        axes.legend()
    return figure
