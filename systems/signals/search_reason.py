"""Reasons for which a tracker finds no needle, in words for a person, and what to change."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, auto
from typing import Self


class Reader(Enum):
    """Who reads advice: the author of a scenario or a recording, or the operator of a drive."""

    SCENARIO = auto()
    RECORDING = auto()
    RECORDING_ANYWHERE = auto()
    """Of a recording that is searched as that advice would have it already."""
    OPERATOR = auto()


_START = "--start anywhere"


@dataclass(frozen=True)
class Remedy:
    """Something to change, and the fields of a scenario and options of `sonoservo track` for it.

    Empty if there are none; None if it is no advice for a run, or none for a recording.
    """

    words: str
    fields: str | None = None
    options: str | None = None


def advice(remedies: Iterable[Remedy], reader: Reader) -> str:
    """Return what a reader can change, in words with the names in brackets; empty if nothing."""
    said = []
    for each in remedies:
        recorded = reader in (Reader.RECORDING, Reader.RECORDING_ANYWHERE)
        names = each.options if recorded else each.fields
        done = reader is Reader.RECORDING_ANYWHERE and names == _START
        if names is not None and not done:
            shown = names and reader is not Reader.OPERATOR
            said.append(f"{each.words} ({names})" if shown else each.words)
    return ", or ".join(said)


LONGER = Remedy("let the run be longer", "duration")
_RECORD = Remedy("record volumes", options="")
_IN_SIGHT = Remedy("push the needle in while the probe looks on", "hand.pushes, hand.aim", "")
_FURTHER = Remedy("push the needle further into view", "hand.pushes")
_SLOWLY = Remedy("push the needle more slowly", "hand.pushes", "")
_OFTEN = Remedy("record more volumes a second", "imaging.volume_rate", "")
_ANYWHERE = Remedy("look for it in whole volumes", "tracker.start=anywhere", _START)
_BRIGHTER = Remedy("make it brighter", "scanner.needle")
_LOOK = Remedy(
    "look at the volumes (--show): does the sound run as --depth says, is the needle brighter than "
    "the rest (--window), are the voxels as large as the file says (sonoservo check)?",
    options="",
)
_FAINT = (_FURTHER, _BRIGHTER, Remedy("hold it less steeply", "hand.dip_deg"), _LOOK)


class SearchReason(Enum):
    """Kinds of reasons for which there is no needle in a volume.

    Each has the beginning of its sentences, which may go on with figures, a few words without
    figures, and remedies.
    """

    NO_VOLUME = ("no volume", "there is no volume", LONGER, _RECORD)
    NO_SWEEP = ("no sweep", "there is no volume", LONGER, _RECORD)
    NOTHING_EARLIER = (
        "there is no earlier volume",
        "there is nothing to compare with yet",
        LONGER,
        Remedy("wait some seconds before the needle is pushed in", "hand.start", ""),
        _ANYWHERE,
    )
    OTHER_SETTINGS = (
        "the previous volume",
        "the scanner's settings have changed",
        Remedy("keep the scanner's settings while the tracker searches", "imaging", ""),
    )
    NOTHING_CHANGES = ("nothing changed", "nothing changes", _IN_SIGHT, _BRIGHTER, _ANYWHERE)
    SPREAD = (
        "the change is spread",
        "too much changes at once",
        _SLOWLY,
        Remedy("keep tissue and probe still", options=""),
        _ANYWHERE,
    )
    INSIDE = (
        "the change lies",
        "the change is far inside the image",
        Remedy("let the needle come in from the side of the image", "", ""),
        _ANYWHERE,
    )
    MOTION_UNCONFIRMED = (
        "something moved",
        "something moved, and is not confirmed yet",
        Remedy("push the needle further in or more slowly", "hand.pushes", ""),
        _OFTEN,
    )
    UNCERTAIN = (
        "no line is a needle with certainty",
        "no line is a needle with certainty yet",
        LONGER,
        _FURTHER,
        Remedy(
            "record more volumes of the needle, three at least and seconds apart at most", None, ""
        ),
        _ANYWHERE,
    )
    NOT_DETECTED = ("no needle has been", "no needle has been detected", _ANYWHERE, *_FAINT)
    THERE_BEFORE = (
        "the line most like a needle was there",
        "the line most like a needle was there before",
        _IN_SIGHT,
        Remedy("take any line that looks like one", "tracker.start=anywhere", _START),
    )
    RIDES = (
        "the line most like a needle moves along",
        "the line most like a needle moves along with the probe",
        *_FAINT,
    )
    APPEARED = (
        "the line most like a needle appeared",
        "the line most like a needle appeared at once",
        _SLOWLY,
        _OFTEN,
    )
    NO_BRIGHT_LINE = ("no bright line", "no bright line is seen", *_FAINT)
    NO_LINE = ("no line", "no line stands out as a needle does", *_FAINT)
    NOT_AS_EXPECTED = ("none of", "nothing lies where the needle is expected", *_FAINT)
    NOTHING_ALONG = ("nothing along", "no needle stands out along its line", *_FAINT)
    HARDLY_SEEN = ("only", "too little of the needle is seen", *_FAINT)
    OFF_PREDICTION = ("the measurement is", "what is found lies far from the prediction", *_FAINT)
    TIMES = (
        "a volume is refused: its time",
        "the volume's time is not plausible",
        Remedy("see that the times are in seconds", options=""),
        Remedy("give the volumes' rate", options="--volume-rate"),
    )
    REFUSED = (
        "a volume is refused",
        "the volume is refused",
        Remedy("see in estimates.csv why, and what sonoservo check says of the source", None, ""),
    )
    OUT_OF_VIEW = ("the predicted needle lies outside", "the needle has left the view")
    NOT_ALIKE = ("the line found", "the line found is like no needle", *_FAINT)
    WITHDRAWN = ("the needle was withdrawn", "the needle was withdrawn")
    TRACKED = ("a needle is being tracked", "a needle is being tracked")

    def __init__(self, begins: str, words: str, *remedies: Remedy) -> None:
        self.begins, self.words, self.remedies = begins, words, remedies

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

    def advice(self, reader: Reader) -> str:
        """Return what a reader can change about the most frequent kind; may be empty."""
        kinds = (each for each, _ in self._counts.most_common() if isinstance(each, SearchReason))
        said = (advice(each.remedies, reader) for each in kinds)
        return next(filter(None, said), "")
