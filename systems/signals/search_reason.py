"""Reasons for which a tracker finds no needle: their kinds, words for a person, and what to change.

Advice for a run names fields of its scenario; advice for a person's own volumes names the volumes
and options of `sonoservo track`.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Self


@dataclass(frozen=True, eq=False)
class _Search:
    """Words and advice for a kind of reason."""

    begins: str
    """Beginning of the sentences of this kind, which may go on with figures."""

    words: str
    """The same in a few words, without figures."""

    run_advice: str = ""
    """What to change in a scenario so that the needle is found; may be empty."""

    track_advice: str = ""
    """What to change with volumes of one's own; may be empty."""


_FAINT = (
    "push the needle further into view (hand.pushes), or make it brighter (scanner.needle) or less "
    "steep (hand.dip_deg)"
)
_UNSEEN = (
    "look at the volumes (--show): does the sound run as --depth says, is the needle brighter than "
    "the rest (--window), are the voxels as large as the file says (sonoservo check)?"
)
_LONGER = "let the run be longer (duration)"
_ANYWHERE = "look for it in whole volumes (--start anywhere)"


class SearchReason(_Search, Enum):
    """Kinds of reasons for which there is no needle in a volume."""

    NO_VOLUME = ("no volume", "there is no volume", _LONGER, "record volumes")
    NO_SWEEP = ("no sweep", "there is no volume", _LONGER, "record volumes")
    NOTHING_EARLIER = (
        "there is no earlier volume",
        "there is nothing to compare with yet",
        "let the run be longer (duration) or the hand start later (hand.start)",
        f"record some seconds before the needle is pushed in, or {_ANYWHERE}",
    )
    OTHER_SETTINGS = (
        "the previous volume",
        "the scanner's settings have changed",
        "keep the scanner's settings (imaging) while the tracker searches",
        "keep the scanner's settings while the tracker searches",
    )
    NOTHING_CHANGES = (
        "nothing changed",
        "nothing changes",
        "push the needle into view (hand.pushes, hand.aim), or make its echo brighter "
        "(scanner.needle)",
        f"push the needle in while volumes are recorded, or {_ANYWHERE}",
    )
    SPREAD = (
        "the change is spread",
        "too much changes at once",
        "push the needle more slowly (hand.pushes), or look for it in whole volumes: "
        "tracker.start=anywhere",
        f"push the needle more slowly, keep tissue and probe still, or {_ANYWHERE}",
    )
    INSIDE = (
        "the change lies",
        "the change is far inside the image",
        "let the needle come in from the side of the image, or look for it in whole volumes: "
        "tracker.start=anywhere",
        f"let the needle come in from the side of the image, or {_ANYWHERE}",
    )
    MOTION_UNCONFIRMED = (
        "something moved",
        "something moved, and is not confirmed yet",
        "push the needle further in or more slowly (hand.pushes), or raise imaging.volume_rate",
        "push the needle further in or more slowly, or record more volumes a second",
    )
    UNCERTAIN = (
        "no line is a needle with certainty",
        "no line is a needle with certainty yet",
        "let the run be longer (duration), or push the needle further into view (hand.pushes)",
        "record more volumes; one sweep over the needle is not enough, three are",
    )
    NOT_DETECTED = (
        "no needle has been",
        "no needle has been detected",
        _FAINT,
        f"{_UNSEEN} Or {_ANYWHERE}",
    )
    THERE_BEFORE = (
        "the line most like a needle was there",
        "the line most like a needle was there before",
        "push the needle into view while the probe looks on, or take any line that looks like one: "
        "tracker.start=anywhere",
        "record from before the needle comes in, or take any line that looks like one "
        "(--start anywhere)",
    )
    RIDES = (
        "the line most like a needle moves along",
        "the line most like a needle moves along with the probe",
        _FAINT,
        _UNSEEN,
    )
    APPEARED = (
        "the line most like a needle appeared",
        "the line most like a needle appeared at once",
        "push the needle more slowly (hand.pushes), or raise imaging.volume_rate",
        "push the needle more slowly, or record more volumes a second",
    )
    NO_BRIGHT_LINE = ("no bright line", "no bright line comes in from the side", _FAINT, _UNSEEN)
    NO_LINE = ("no line", "no line stands out as a needle does", _FAINT, _UNSEEN)
    NOT_AS_EXPECTED = ("none of", "nothing lies where the needle is expected", _FAINT, _UNSEEN)
    NOTHING_ALONG = ("nothing along", "no needle stands out along its line", _FAINT, _UNSEEN)
    HARDLY_SEEN = ("only", "too little of the needle is seen", _FAINT, _UNSEEN)
    OFF_PREDICTION = (
        "the measurement is",
        "what is found lies far from the prediction",
        _FAINT,
        _UNSEEN,
    )
    OUT_OF_VIEW = ("the predicted needle lies outside", "the needle has left the view")
    NOT_ALIKE = ("the line found", "the line found is like no needle", _FAINT, _UNSEEN)
    WITHDRAWN = ("the needle was withdrawn", "the needle was withdrawn")
    TRACKED = ("a needle is being tracked", "a needle is being tracked")

    def __call__(self, rest: str = "") -> "Reason":
        """Return the reason as a sentence that goes on with its figures."""
        return Reason(self, f"{self.begins}{rest}")

    @classmethod
    def of(cls, text: str) -> "SearchReason | None":
        """Return the kind of a reason: its own, or that of a sentence from a log; None if none."""
        if isinstance(text, Reason):
            return text.kind
        return next((each for each in cls if text.startswith(each.begins)), None)


class Reason(str):
    """A reason as a sentence with figures, which knows its kind."""

    kind: SearchReason

    def __new__(cls, kind: SearchReason, text: str) -> Self:
        """Return the sentence."""
        reason = super().__new__(cls, text)
        reason.kind = kind
        return reason


class ReasonCount:
    """Counts how often each kind of reason was given."""

    def __init__(self, reasons: Iterable[str] = ()) -> None:
        self._counts: Counter[SearchReason | str] = Counter()
        for reason in reasons:
            self.add(reason)

    def add(self, reason: str) -> None:
        """Count a reason; one of no known kind is a kind of its own, an empty one is none."""
        if reason:
            self._counts[SearchReason.of(reason) or str(reason)] += 1

    @property
    def words(self) -> dict[str, int]:
        """Numbers by the reasons in a few words, the most frequent first."""
        return {
            each.words if isinstance(each, SearchReason) else each: count
            for each, count in self._counts.most_common()
        }

    @property
    def advice(self) -> str:
        """What a person with volumes can change about the most frequent kind; may be empty."""
        kinds = (each for each, _ in self._counts.most_common() if isinstance(each, SearchReason))
        return next((each.track_advice for each in kinds if each.track_advice), "")
