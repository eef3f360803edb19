"""Results of `palpate objects import`, `list`, `show` and `check`.

Formats `palpate/import@1`, `palpate/objects-inventory@1`, `palpate/objects-listing@1` and
`palpate/objects-check@1`.
"""

from typing import Literal

from palpate.base.tips import TipShape
from palpate.base.vocabulary import PushResponse
from palpate.config.fields import Interval, Out, Rounded


class FrameOut(Out):
    """Place of the model in the file: its point p is rotation · (point of the file, mm) + offset."""

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


class OmittedStatesOut(Out):
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
    left_out: tuple[OmittedStatesOut, ...]


class ImportedFileOut(Out):
    """What became of one of several files: `objects` that it holds; `kept`: they were up to date, or it was
    refused before and has not changed.

    `failure`: why there are none. `refused`: parts of the file that are no objects, and why, a line each.
    """

    file: str
    objects: tuple[str, ...]
    kept: bool
    failure: str | None
    refused: tuple[str, ...] = ()
    seconds: Rounded


class ImportOut(Out):
    """Files that were read, what was made of them, and the objects file that it is in now.

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


class InventoryStateOut(Out):
    """A state: `height` of the part in it, mm; `heights`: where its sections are known, null: everywhere.

    `down`: direction of the CAD file that points down; `tipping_angle`: smallest tilt that tips it over, rad.
    """

    name: str
    probability: Rounded | None
    down: tuple[Rounded, Rounded, Rounded] | None
    tipping_angle: Rounded | None
    height: Rounded
    heights: tuple[Interval, ...] | None


class InventoryObjectOut(Out):
    """An object of an objects file; `size` (mm, along the axes of its CAD file), `mass_g` and `source`, that
    file as the import has written it, are null where they are not said.
    """

    name: str
    tags: tuple[str, ...]
    size: tuple[Rounded, Rounded, Rounded] | None
    mass_g: Rounded | None
    tolerance: Rounded
    states: tuple[InventoryStateOut, ...]
    source: str | None


class InventoryOut(Out):
    """Objects of a file, and the CAD files that the import has `refused`."""

    format: Literal["palpate/objects-inventory@1"] = "palpate/objects-inventory@1"
    units: Literal["mm, g, rad"] = "mm, g, rad"
    objects_file: str
    objects: tuple[InventoryObjectOut, ...]
    refused: tuple[str, ...]


class StateNameOut(Out):
    """A state of an object of the file."""

    object: str
    state: str


class RigHeightOut(Out):
    """A height at which fingers are, mm over the support plane; `tip_radius_mm`: of the slimmest there."""

    height_mm: Rounded
    tip_radius_mm: Rounded
    tip_shape: TipShape
    fingers: tuple[str, ...]


class RigHeightsOut(Out):
    """Properties of a rig that decide which states it can tell apart.

    `contact_bound_mm`: how far off a contact may be at most, about the middle of the table.
    """

    name: str
    shipped: bool
    heights: tuple[RigHeightOut, ...]
    contact_bound_mm: Rounded


class PairOut(Out):
    """Two states that are not sure to be told apart.

    `likeness`: "same" if they can never be, because what fingers reach of them agrees within their own
    tolerances; "doubtful" if it agrees within what contacts may hide besides; "unknown" if one is not known
    at the height of some finger and the others do not tell them apart. `apart_mm`: largest distance of the
    sections at `compared_mm`, in the best fit; null if no finger there meets either. `tolerance_mm`: of both
    together; `within_mm`: that and twice the bound of contacts.
    """

    first: StateNameOut
    second: StateNameOut
    likeness: Literal["same", "doubtful", "unknown"]
    apart_mm: Rounded | None
    tolerance_mm: Rounded
    within_mm: Rounded
    compared_mm: tuple[Rounded, ...]


class SeparatingOut(PairOut):
    """A pair with the heights at which one more finger would tell the two apart for certain, mm.

    Its tip is the slimmest and shortest upright one of the rig, or its smallest ball if all are balls; for a
    ball there are single heights, each as a range from it to itself. `tried` of `ranges`: how many of the
    ranges over which neither section changes were looked at. `known`: whether both states are known at all
    heights.
    """

    separating_mm: tuple[Interval, ...]
    tried: int
    ranges: int
    known: bool


class UnknownHeightOut(Out):
    """A state that is not known at heights of the rig's fingers, mm."""

    state: StateNameOut
    heights_mm: tuple[Rounded, ...]


class StateListedOut(Out):
    """A state, as it stands in the file.

    `edges`: fewest and most of a section. `heights_mm`: ranges at which the sections are known, null for all.
    `top_mm`: how high it is. `symmetry_order`: it looks the same after each nth of a turn.
    `fingers`: how many of the rig's meet it; "unknown" if it is not known at the height of some.
    `when_pushed`: what it may do when the rig's fingers push it, and `why`; null if it slides.
    `base_margin_mm`: from below its centre of mass to the nearest edge of its base, at least; 0 if not known.
    """

    object: str
    state: str
    sections: int
    edges: tuple[int, int]
    top_mm: Rounded
    heights_mm: tuple[Interval, ...] | None
    symmetry_order: int
    fingers: Literal["all", "some", "none", "unknown"]
    probability: Rounded | None
    tipping_angle_rad: Rounded | None
    tolerance_mm: Rounded
    when_pushed: PushResponse
    why: str | None
    base_margin_mm: Rounded


class ObjectsListingOut(Out):
    """Every state of the file, and those that the rig's fingers do not tell apart for certain.

    `pictures`: where the picture was written, page by page, and `picture` the first of them; `left_out`:
    states that are not in it, because it would get too large.
    """

    format: Literal["palpate/objects-listing@1"] = "palpate/objects-listing@1"
    objects: str
    rig: RigHeightsOut
    states: tuple[StateListedOut, ...]
    twins: tuple[PairOut, ...]
    picture: str
    pictures: tuple[str, ...]
    left_out: tuple[StateNameOut, ...]


class ObjectsCheckOut(Out):
    """States that a rig's fingers cannot, or may not, tell apart. `pairs_compared`: all with each other.

    `told_apart`: so many of them are told apart for certain, wherever the fingers can reach.
    """

    format: Literal["palpate/objects-check@1"] = "palpate/objects-check@1"
    objects: str
    rig: RigHeightsOut
    states: int
    pairs_compared: int
    told_apart: int
    pairs: tuple[SeparatingOut, ...]
    not_known: tuple[UnknownHeightOut, ...]
