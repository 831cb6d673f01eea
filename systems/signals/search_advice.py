"""Reasons for which a tracker finds no needle, in words, and what to change."""

_FAINT = (
    "push the needle further into view (hand.pushes), or make it brighter (scanner.needle) or less "
    "steep (hand.dip_deg)"
)
_CASES = (
    ("no volume", "there is no volume", "let the run be longer (duration)"),
    ("no sweep", "there is no volume", "let the run be longer (duration)"),
    (
        "there is no earlier volume",
        "there is nothing to compare with yet",
        "let the run be longer (duration) or the hand start later (hand.start)",
    ),
    (
        "the probe moved",
        "the probe moves",
        "let the hand wait until the probe rests: leave hand.start out, or set it later",
    ),
    (
        "the previous volume",
        "the scanner's settings have changed",
        "keep the scanner's settings (imaging) while the tracker searches",
    ),
    (
        "nothing changed",
        "nothing changes",
        "push the needle into view (hand.pushes, hand.aim), or make its echo brighter "
        "(scanner.needle)",
    ),
    (
        "the change is spread",
        "too much changes at once",
        "push the needle more slowly (hand.pushes), or look for it in whole volumes: "
        "tracker.start=anywhere",
    ),
    (
        "the change lies",
        "the change is far inside the image",
        "let the needle come in from the side of the image, or look for it in whole volumes: "
        "tracker.start=anywhere",
    ),
    (
        "something moved",
        "something moved, and is not confirmed yet",
        "push the needle further in or more slowly (hand.pushes), or raise imaging.volume_rate",
    ),
    (
        "a needle was found",
        "a needle was found, and is not confirmed yet",
        "let the run be longer (duration), or raise imaging.volume_rate",
    ),
    ("no needle in the whole", "no needle in the whole volume", _FAINT),
    ("no needle has been", "no needle has been detected", _FAINT),
    (
        "a line that looks like a needle was",
        "a line was there before, or was not seen to come",
        "push the needle into view while the probe rests, or take any line that looks like one: "
        "tracker.start=anywhere",
    ),
    ("what moved does not", "what moved does not look like a needle", _FAINT),
    ("what was found did not", "what was found did not grow", "push the needle further in"),
    ("no line", "no line stands out as a needle does", _FAINT),
    ("no bright line", "no bright line comes in from the side", _FAINT),
    ("only the end", "only the end of a needle is seen", "push the needle further in"),
    ("none of", "nothing lies where the needle is expected", _FAINT),
    ("nothing along", "no needle stands out along its line", _FAINT),
    (
        "the line found does not come",
        "the line found does not come from outside the image",
        "let the needle come in from the side of the image (hand.entry, hand.aim)",
    ),
    ("the needle was withdrawn", "the needle was withdrawn", ""),
)


def search_words(reason: str) -> str:
    """Return a tracker's reason in a few words without figures; empty if it is none of search."""
    return next((words for begins, words, _ in _CASES if reason.startswith(begins)), "")


def search_advice(reason: str) -> str:
    """Return what a user can change so that the needle is found; empty if unknown."""
    return next((advice for begins, _, advice in _CASES if reason.startswith(begins)), "")
