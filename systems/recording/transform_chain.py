"""Chains of named transforms, from the image or the probe to a frame that stands still."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import suggest
from sonoservo.systems.signals.immutable import Immutable

_NAME = re.compile(r"([A-Z]\w*?)To([A-Z]\w*?)(?:Transform)?")

# Frames of the picture: pixels or voxels, and mm on the sensor of the probe.
_MOVING = ("Image", "Probe")
# Frames that stand still, the preferred ones first.
_FIXED = ("Reference", "World", "Tracker", "TrackerBase", "Ras", "RAS", "Phantom", "Base")
# Tools that move by themselves: no chain may end at one or pass it.
_TOOL = re.compile(r"(Stylus|Needle|Cautery|Pointer|Tool|Scalpel|Trocar|Guide)\w*")
# Frames of the probe and of the picture: no chain may end at one.
_PART = re.compile(r"(Image|Probe|Transducer|Plane|Pixel)\w*")


@dataclass(frozen=True)
class Link(Immutable):
    """A named transform in a chain, or its inverse."""

    name: str
    inverted: bool = False

    def __str__(self) -> str:
        return f"inverse of {self.name}" if self.inverted else self.name


@dataclass(frozen=True)
class TransformChain(Immutable):
    """Transforms from one frame to another, in the order in which they are applied to a point."""

    start: str
    end: str
    links: tuple[Link, ...]

    def __str__(self) -> str:
        return f"{self.start} to {self.end}: {', '.join(map(str, self.links))}"

    def matrix(self, matrices: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return the (4, 4) product of the matrices of its transforms, by name."""
        product = np.eye(4)
        for link in self.links:
            each = matrices[link.name]
            product = (np.linalg.inv(each) if link.inverted else each) @ product
        return product


def ends_of(name: str) -> tuple[str, str] | None:
    """Return the frames that a transform's name states, as ``ProbeToReference``; None if none."""
    match = _NAME.fullmatch(name)
    return (match[1], match[2]) if match else None


def find_chain(
    path: Path, names: Iterable[str], poses: str | None, *, starts: Sequence[str] = _MOVING
) -> TransformChain | None:
    """Return the chain that gives the poses; None if there are no transforms, or none are wanted.

    ``poses`` names transforms to be applied in order, each as it stands or inverted, or the ends of
    a chain that is to be found, or "none"; None finds the one to a fixed frame, from the first of
    the ``starts``.
    """
    known = sorted({name.removesuffix("Transform") for name in names})
    if poses == "none" or (poses is None and not known):
        return None
    if poses is not None:
        return _asked(path, known, [each.strip() for each in poses.split(",") if each.strip()])
    targets = [*_FIXED, *_other_frames(known)]
    for target in targets:
        for start in starts:
            links = _shortest(known, start, target)
            if links:
                return TransformChain(start, target, links)
    named = {frame for name in known for frame in ends_of(name) or ()}
    fixed = f"{_FIXED[0]} or another frame that stands still"
    if named.isdisjoint(starts):
        missing = f"none of them is that of the {' or '.join(each.lower() for each in starts)}"
    else:
        missing = f"a transform from Probe to {fixed} is missing"
    raise ConfigurationError(
        f"{path}: its transforms ({', '.join(known)}) give no pose of the image: {missing}; name a "
        "chain with --poses, or give --poses none"
    )


def _asked(path: Path, known: list[str], words: list[str]) -> TransformChain:
    """Return the chain that a person names."""
    words = [each.removesuffix("Transform") for each in words]
    if not words:
        raise ConfigurationError(f"{path}: poses: it names no transform")
    if len(words) == 1:
        (name,) = words
        ends = ends_of(name)
        if name in known:
            start, end = ends or (name, name)
            return TransformChain(start, end, (Link(name),))
        links = _shortest(known, *ends) if ends else ()
        if not ends or not links:
            others = ", and no other"
            if known:
                others = (
                    f", nor a chain from one of its frames to the other; {suggest(name, known)}"
                )
            raise ConfigurationError(f"{path}: it has no transform {name!r}{others}")
        return TransformChain(*ends, links)
    chain: list[Link] = []
    for name in words:
        if name not in known and _reversed_name(name) not in known:
            raise ConfigurationError(
                f"{path}: it has no transform {name!r}; {suggest(name, known)}"
            )
    here = (ends_of(words[0]) or ("", ""))[0]
    start = here
    for name in words:
        stored, inverted = (name, False) if name in known else (_reversed_name(name), True)
        first, last = ends_of(name) or ("", "")
        if first == here:
            here = last
        elif last == here:
            inverted, here = not inverted, first
        else:
            raise ConfigurationError(
                f"{path}: poses: {name} does not go on from {here}, where the chain has led so far"
            )
        chain.append(Link(stored, inverted))
    return TransformChain(start, here, tuple(chain))


def _reversed_name(name: str) -> str:
    ends = ends_of(name)
    return f"{ends[1]}To{ends[0]}" if ends else ""


def _edges(known: Sequence[str]) -> dict[str, list[tuple[str, Link]]]:
    edges: dict[str, list[tuple[str, Link]]] = {}
    for name in known:
        ends = ends_of(name)
        if ends is not None:
            first, last = ends
            edges.setdefault(first, []).append((last, Link(name)))
            edges.setdefault(last, []).append((first, Link(name, inverted=True)))
    return edges


def _reachable(known: Sequence[str], start: str) -> dict[str, tuple[Link, ...]]:
    """Return the shortest chains from a frame to all others, none of which passes a tool."""
    edges = _edges(known)
    found: dict[str, tuple[Link, ...]] = {start: ()}
    waiting = [start]
    while waiting:
        here = waiting.pop(0)
        if _TOOL.fullmatch(here) and here != start:
            continue
        for there, link in edges.get(here, []):
            if there not in found:
                found[there] = (*found[here], link)
                waiting.append(there)
    return found


def _shortest(known: Sequence[str], start: str, end: str) -> tuple[Link, ...]:
    return _reachable(known, start).get(end, ()) if start != end else ()


def _other_frames(known: Sequence[str]) -> list[str]:
    """Return frames without a known meaning that are no tools and no part of the probe."""
    return [
        each
        for each in sorted(_edges(known))
        if each not in _FIXED and not _TOOL.fullmatch(each) and not _PART.fullmatch(each)
    ]
