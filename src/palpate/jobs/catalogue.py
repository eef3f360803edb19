"""Object models from Python: import from CAD files, listing, picture, and what a rig cannot tell apart."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import Literal

from palpate.base.errors import InputError, warn_operator
from palpate.config import ObjectsFile, RigFile
from palpate.config.catalogue_results import (
    ObjectsCheckOut,
    ObjectsListingOut,
    PairOut,
    RigHeightOut,
    RigHeightsOut,
    SeparatingOut,
    StateListedOut,
    StateNameOut,
    UnknownHeightOut,
)
from palpate.config.import_settings import part_settings
from palpate.config.objects_file import objects_from_text
from palpate.config.objects_tables import ObjectsFileText
from palpate.jobs.files import PathLike, check_arguments
from palpate.rig.catalogue.cad_import import ImportOptions, import_file
from palpate.rig.catalogue.finger_model import RigFingers, rig_fingers
from palpate.rig.catalogue.import_states import ends_mm
from palpate.rig.catalogue.section_stack import Range, StateSections, state_sections, symmetry_of_state
from palpate.rig.catalogue.separating_heights import SeparatingHeights, separating_heights
from palpate.rig.catalogue.twins import Likeness, StatePair, find_twins
from palpate.rig.identification.pushing_mechanics import stability_of
from palpate.views.catalogue.card import CardFacts, TwinNote
from palpate.views.catalogue.picture import draw_objects


def rig_out(fingers: RigFingers, *, shipped: bool) -> RigHeightsOut:
    """The rig's heights."""
    return RigHeightsOut(
        name=fingers.rig_name,
        shipped=shipped,
        heights=tuple(RigHeightOut.of(at, tip_shape=at.shape) for at in fingers.at),
        contact_bound_mm=fingers.bound_mm,
    )


def _name_out(state: StateSections) -> StateNameOut:
    """A state by its names."""
    return StateNameOut(object=state.object_name, state=state.state.name)


def _pair_out(pair: StatePair) -> PairOut:
    """A pair without its heights."""
    return PairOut.of(
        pair,
        first=_name_out(pair.first.state),
        second=_name_out(pair.second.state),
        likeness=pair.likeness.value,
        compared_mm=tuple(at.height_mm for at in pair.compared),
    )


def _separating_out(pair: StatePair, found: SeparatingHeights) -> SeparatingOut:
    """A pair with the heights that would tell its states apart."""
    return SeparatingOut.of(found, **_pair_out(pair).model_dump(), separating_mm=found.heights_mm)


def _not_known_out(states: Sequence[StateSections], fingers: RigFingers) -> tuple[UnknownHeightOut, ...]:
    """States that are not known at the height of some finger."""
    found = []
    for state in states:
        heights = tuple(at.height_mm for at in fingers.at if not state.state.known_within(at.span_mm))
        if heights:
            found.append(UnknownHeightOut(state=_name_out(state), heights_mm=heights))
    return tuple(found)


_LIKENESS_WORDS = {
    Likeness.SAME: "feels like",
    Likeness.DOUBTFUL: "may feel like",
    Likeness.UNKNOWN: "as far as known like",
}


@check_arguments
def import_objects(
    path: PathLike,
    *,
    heights_mm: Sequence[float | tuple[float, float]] | None = None,
    progress: Callable[[str], None] = lambda _: None,
    **settings: object,
) -> ObjectsFile:
    """Import object models from a CAD file: stable states and their cross sections.

    STL, OBJ, PLY, 3MF, STEP, DXF, SVG. `heights_mm` at which sections are wanted, or (from, to); None: all.
    `settings`: those of `palpate objects import` for a file, by their names in `palpate-import.toml`, such as
    units="mm" and thickness_mm=10.0 (docs/importing.md). Raises InputError for these, and,
    with the place, for surfaces that are not closed, open outlines, files without units and the like. Warns
    (`RigWarning`) of parts that are refused where others of the file are not.
    """
    heights = None if heights_mm is None else tuple(heights_mm)
    if not all(0 <= low <= high < math.inf for low, high in map(ends_mm, heights or ())):
        raise InputError(f"import_objects: heights_mm are from 0 on, ranges from low to high, not {heights}")
    options = ImportOptions.of(part_settings(settings, "import_objects"), heights)
    imported = import_file(Path(path), options, progress)
    for line in imported.refused:
        warn_operator(f"{path}: {line}")
    tables = [item.text for item in imported.objects]
    text = ObjectsFileText(format="palpate/objects@1", units="mm", objects=tables)
    return objects_from_text(text, str(path))


@check_arguments
def check_objects(
    rig: RigFile,
    objects: ObjectsFile,
    *,
    name: str = "the catalogue",
    shipped: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> ObjectsCheckOut:
    """Find the states that a rig's fingers can never tell apart, and heights at which a finger would.

    `name` of the objects and whether the rig is the `shipped` one stand in the result.
    """
    fingers, states = rig_fingers(rig), state_sections(objects)
    progress(f"{len(states)} states")
    pairs = find_twins(states, fingers)
    found = []
    for number, pair in enumerate(pairs, 1):
        progress(f"heights of pair {number} of {len(pairs)}")
        found.append(_separating_out(pair, separating_heights(pair)))
    compared = len(states) * (len(states) - 1) // 2
    return ObjectsCheckOut(
        objects=name,
        rig=rig_out(fingers, shipped=shipped),
        states=len(states),
        pairs_compared=compared,
        told_apart=compared - len(pairs),
        pairs=tuple(found),
        not_known=_not_known_out(states, fingers),
    )


@dataclass(frozen=True, eq=False, repr=False)
class ObjectsListing:
    """States of a catalogue, pairs that a rig does not tell apart, and pictures (SVG) of the sections.

    `pages`: one picture, or several of a large catalogue.
    """

    states: tuple[StateListedOut, ...]
    pairs: tuple[StatePair, ...]
    left_out: tuple[StateSections, ...]
    pages: tuple[str, ...]

    def out(self, rig: RigFile, objects: str, pictures: Sequence[str], *, shipped: bool) -> ObjectsListingOut:
        """`palpate/objects-listing@1`, for the objects file and the pictures of these names."""
        return ObjectsListingOut(
            objects=objects,
            rig=rig_out(rig_fingers(rig), shipped=shipped),
            states=self.states,
            twins=tuple(_pair_out(pair) for pair in self.pairs),
            picture=pictures[0],
            pictures=tuple(pictures),
            left_out=tuple(_name_out(state) for state in self.left_out),
        )

    def _repr_svg_(self) -> str:
        return self.pages[0]

    def __repr__(self) -> str:
        return f"<ObjectsListing {len(self.states)} states, {len(self.pairs)} pairs not told apart>"


@check_arguments
def list_objects(
    rig: RigFile,
    objects: ObjectsFile,
    *,
    name: str = "the catalogue",
    progress: Callable[[str], None] = lambda _: None,
) -> ObjectsListing:
    """List and draw every state of every object, with those that a rig's fingers would not tell apart."""
    fingers, states = rig_fingers(rig), state_sections(objects)
    progress(f"comparing {len(states)} states")
    pairs = find_twins(states, fingers)
    progress("drawing")
    notes = _twin_notes(pairs)
    facts = {
        state: CardFacts(0 if state.state.is_round else symmetry_of_state(state).order, notes.get(state, ()))
        for state in states
    }
    pages, left_out = draw_objects(name, states, facts, fingers)
    spans = [finger.span_mm for finger in rig.fingers]
    listed = tuple(_state_listing(state, facts[state], spans) for state in states)
    return ObjectsListing(listed, tuple(pairs), tuple(left_out), pages)


def _twin_notes(pairs: Sequence[StatePair]) -> dict[StateSections, tuple[TwinNote, ...]]:
    """Return which states feel like each one, or may; those that do for certain first."""
    found: dict[StateSections, dict[Likeness, list[str]]] = {}
    for pair in pairs:
        for state, other in permutations((pair.first.state, pair.second.state)):
            same_object = other.object_name == state.object_name
            name = other.state.name if same_object else other.name
            found.setdefault(state, {}).setdefault(pair.likeness, []).append(name)
    return {
        state: tuple(
            TwinNote(words, tuple(others[likeness]))
            for likeness, words in _LIKENESS_WORDS.items()
            if likeness in others
        )
        for state, others in found.items()
    }


def _meeting_fingers(
    state: StateSections, spans_mm: Sequence[Range]
) -> Literal["all", "some", "none", "unknown"]:
    """Return which of the fingers whose tips' ends are at some heights meet a state."""
    if not all(state.state.known_within(span) for span in spans_mm):
        return "unknown"
    met = [bool(state.state.sections_within(span)) for span in spans_mm]
    return "all" if all(met) else "some" if any(met) else "none"


def _state_listing(state: StateSections, facts: CardFacts, spans_mm: Sequence[Range]) -> StateListedOut:
    edges = [level.edges for level in state.levels]
    stability = stability_of(state.state, state.tolerance_mm, spans_mm)
    return StateListedOut.of(
        state.state,
        object=state.object_name,
        state=state.state.name,
        sections=len(state.levels),
        edges=(min(edges), max(edges)),
        symmetry_order=facts.symmetry_order,
        fingers=_meeting_fingers(state, spans_mm),
        tolerance_mm=state.tolerance_mm,
        when_pushed=stability.response,
        why=stability.why or None,
        base_margin_mm=stability.margin_mm,
    )
