"""Result of `palpate objects import`: `palpate/import@1`."""

from typing import Literal

from palpate.config.results import Interval, Out, Rounded

__all__ = ["FrameOut", "ImportOut", "ImportedFileOut", "ImportedObjectOut", "ImportedStateOut", "LeftOutOut"]


class FrameOut(Out):
    """Where the model lies in the file: its point p is rotation · (point of the file, mm) + offset."""

    rotation: tuple[tuple[Rounded, Rounded, Rounded], ...]
    offset: tuple[Rounded, Rounded, Rounded]


class ImportedStateOut(Out):
    """A state that was written; null is what nobody knows.

    `heights`: where its sections are known, null: everywhere. `edges`: fewest and most of a section.
    `section_tolerance`, `merged_tolerance`: mm, how far true sections may be from those written because few
    stand for many, and because states that are nearly the same were made one; `merged`: how many were.
    """

    name: str
    probability: Rounded | None
    tipping_angle: Rounded | None
    height: Rounded
    heights: tuple[Interval, ...] | None
    sections: int
    edges: tuple[int, int]
    merged: int
    section_tolerance: Rounded
    merged_tolerance: Rounded
    frame: FrameOut


class LeftOutOut(Out):
    """Ways to rest that were not written: why, how many, and how often the part comes to rest so."""

    reason: str
    states: int
    probability: Rounded


class ImportedObjectOut(Out):
    """A part: `size` and `volume` as the file has it (mm, mm³; null for a drawing).

    `tolerance` is what was written: `curve_tolerance` of curves that became edges, `deviation` of the made
    part from its drawing, and the most that any state adds.
    """

    name: str
    replaced: bool
    size: tuple[Rounded, ...]
    volume: Rounded | None
    facets: int | None
    tolerance: Rounded
    curve_tolerance: Rounded
    deviation: Rounded
    states: tuple[ImportedStateOut, ...]
    left_out: tuple[LeftOutOut, ...]


class ImportedFileOut(Out):
    """What became of one of several files: `objects` that it holds; `kept`: they were up to date, or it was
    refused before and has not changed.

    `failure`: why there are none.
    """

    file: str
    objects: tuple[str, ...]
    kept: bool
    failure: str | None
    seconds: Rounded


class ImportOut(Out):
    """What was read, what was made of it, and the objects file that it is in now.

    `files`: of several files, what became of each; `objects` are those that were made anew.
    """

    format: Literal["palpate/import@1"] = "palpate/import@1"
    units: Literal["mm, rad"] = "mm, rad"
    source: str
    objects_file: str
    bytes: int
    objects: tuple[ImportedObjectOut, ...]
    warnings: tuple[str, ...]
    files: tuple[ImportedFileOut, ...] = ()
    seconds: Rounded
