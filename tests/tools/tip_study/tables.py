"""Table and figure of the study."""

from collections import namedtuple

import matplotlib.pyplot as plt
import numpy as np

RESAMPLES = 2000
HEAD = (
    "| tip | contrast | depth | dip | found | bias | deviation | middle 68 % | least "
    "| with phases | deviation / least |",
    "|---|---|---|---|---|---|---|---|---|---|---|",
)


Figures = namedtuple("Figures", "found bias deviation half_width least with_phases ratio low high")
"""Figures of all volumes with needles of a kind; lengths are in mm."""


def figures(errors, bound):
    """Figures of our errors, NaN where no needle was found, and of the bound."""
    known = errors[np.isfinite(errors)]
    rng = np.random.default_rng(0)

    def ratio(errors, variances):
        return np.std(errors, ddof=1) / np.sqrt(np.mean(variances))

    def resampled(values):
        return rng.choice(values, len(values))

    ratios = [ratio(resampled(known), resampled(bound.variances)) for _ in range(RESAMPLES)]
    return Figures(
        len(known) / len(errors),
        1e3 * np.mean(known),
        1e3 * np.std(known, ddof=1),
        1e3 * float(np.diff(np.quantile(known, [0.16, 0.84]))[0]) / 2,
        1e3 * bound.std,
        1e3 * bound.field_std,
        ratio(known, bound.variances),
        *np.quantile(ratios, [0.025, 0.975]),
    )


def line_of(end, errors, bound):
    """Line of the table in Markdown."""
    f = figures(errors, bound)
    return (
        f"| {end.tip} | {end.contrast:g} dB | {1e3 * end.depth:g} mm | {end.dip:g} deg "
        f"| {f.found:.0%} | {f.bias:.2f} | {f.deviation:.2f} | {f.half_width:.2f} | {f.least:.2f} "
        f"| {f.with_phases:.2f} | {f.ratio:.1f} ({f.low:.1f} to {f.high:.1f}) |"
    )


def plot(rows, path):
    """Draw the errors over dip, with a row of panels for each tip, of each contrast and depth."""
    tips = sorted({end.tip for end in rows}, reverse=True)
    columns = sorted({(end.depth, end.contrast) for end in rows})
    drawn, axes = plt.subplots(
        len(tips), len(columns), sharex=True, sharey=True, squeeze=False,
        figsize=(3.2 * len(columns), 2.6 * len(tips)), layout="constrained",
    )  # fmt: skip
    for row, tip in enumerate(tips):
        for column, (depth, contrast) in enumerate(columns):
            ax = axes[row, column]
            of = sorted(
                (end.dip, figures(*pair))
                for end, pair in rows.items()
                if (end.tip, end.depth, end.contrast) == (tip, depth, contrast)
            )
            dips = [dip for dip, _ in of]
            for style, colour, label, values in (
                ("o-", "C3", "ours: deviation", [f.deviation for _, f in of]),
                ("o:", "C3", "ours: middle 68 %", [f.half_width for _, f in of]),
                ("x--", "0.5", "ours: |bias|", [abs(f.bias) for _, f in of]),
                ("s-", "C0", "least", [f.least for _, f in of]),
                ("s:", "C0", "least with phases", [f.with_phases for _, f in of]),
            ):
                ax.semilogy(dips, values, style, color=colour, label=label)
            ax.set_title(f"{tip}, {contrast:g} dB, {1e3 * depth:g} mm deep", fontsize="medium")
            ax.grid(which="both", color="0.92")
            ax.set_xticks(dips)
    for ax in axes[-1]:
        ax.set_xlabel("dip in deg")
    for ax in axes[:, 0]:
        ax.set_ylabel("along the needle in mm")
    drawn.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    drawn.savefig(path, dpi=110)
    plt.close(drawn)
