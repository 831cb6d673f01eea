"""Tables of the study's figures."""

import itertools

import numpy as np

from .runs import KINDS, SEEN, STARTS


def quantiles(values):
    """Median and 95 % quantile of absolute values in m, as text in mm."""
    if not len(values):
        return "-, -"
    return ", ".join(f"{1e3 * q:.2f}" for q in np.quantile(np.abs(values), [0.5, 0.95]))


def share(flags):
    """Share of flags that are set, as text."""
    flags = list(flags)
    return f"{np.mean(flags):.0%} of {len(flags)}" if flags else "-"


def table_of_volumes(rows):
    """Lines of the table about single volumes."""
    lines = []
    groups = {
        "needle, plain": [r for r in rows if r["needle"] and not r["kinds"]],
        "needle, structures": [r for r in rows if r["needle"] and r["kinds"]],
        "needle, all": [r for r in rows if r["needle"]],
        f"needle, {1e3 * SEEN:.0f} mm visible": [r for r in rows if r["seen"] >= SEEN],
    }
    for name, group in groups.items():
        found = [r for r in group if r["found"]]
        right = [r["outcome"] for r in found if r["outcome"].right]
        wrong = len(found) - len(right)
        tips = [o.tip for o in right]
        clear = [o.tip for o in right if o.tip_seen]
        confidence = [r["confidence"] for r in found if r["outcome"].right]
        lines.append(
            f"{name:26} found {share(bool(r.get('outcome')) and r['outcome'].right for r in group)}"
            f", wrong {wrong}, turned {sum(o.turned for o in right)}; "
            f"tip {quantiles(tips)} mm, visible tip {quantiles(clear)} mm; along "
            f"{quantiles([o.along for o in right])}, across "
            f"{quantiles([o.across for o in right])} mm; confidence "
            f"{np.median(confidence or [np.nan]):.2f}"
        )
    for name, chosen in (("no needle, plain", False), ("no needle, structures", True)):
        group = [r for r in rows if not r["needle"] and bool(r["kinds"]) == chosen]
        false = [r["confidence"] for r in group if r["found"]]
        lines.append(
            f"{name:26} false {len(false)} of {len(group)}; confidence "
            f"{', '.join(f'{each:.2f}' for each in sorted(false)) or '-'}"
        )
    lines.append(f"locate: median {1e3 * np.median([r['s'] for r in rows]):.0f} ms")
    return lines


def table_of_sequences(rows):
    """Lines of the table about sequences."""
    lines = []
    # The start "search" waits for an insertion seen by a probe at rest.
    for start, kind in itertools.product(STARTS, (*KINDS, "probe at rest", "all")):
        rest = {"probe at rest": (False,)}.get(kind, (False, True))
        group = [r for r in rows if r["start"] == start and r["moving"] in rest]
        group = [r for r in group if r["kind"] == kind or kind not in KINDS]
        needles = [r for r in group if r["kind"] != "no needle"]
        outcomes = [o for r in needles for o in r["outcomes"]]
        expected, tracked = (sum(r[name] for r in needles) for name in ("expected", "tracked"))
        found = share(any(o.right for o in r["outcomes"]) for r in needles if r["expected"])
        false = sum(r["starts"].count(False) for r in group)
        ghosts = sum(r["ghosts"] for r in group)
        clear = [o.tip for o in outcomes if o.tip_seen]
        lines.append(
            f"{start:8} {kind:15} found {found}, tracked {tracked} of {expected} volumes, "
            f"right {share(o.right for o in outcomes)}, "
            f"turned {share(o.turned for o in outcomes)}; false starts {false} in {len(group)} "
            f"sequences, tracked without needle {ghosts}; tip "
            f"{quantiles([o.tip for o in outcomes])} mm, visible tip {quantiles(clear)} mm; "
            f"in stated 95 %: along {share(o.within_along for o in outcomes)}, across "
            f"{share(o.within_across for o in outcomes)}"
        )
    return lines
