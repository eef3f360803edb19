"""`palpate objects show`: what a file of objects holds, as a listing and as a picture."""

from collections.abc import Sequence
from pathlib import Path

import typer

from palpate.cli.terminal import Doing, Terminal
from palpate.config import load_objects
from palpate.config.objects_result import ObjectsListingOut, StateListedOut
from palpate.config.results import to_json
from palpate.files.writing import check_place, write_text
from palpate.rig.calibrated_rig import load_calibrated
from palpate.rig.catalogue.finger_model import rig_fingers
from palpate.rig.catalogue.section_stack import StateSections, state_sections
from palpate.rig.catalogue.symmetry import symmetry_of_state
from palpate.rig.catalogue.twins import Likeness, Pair, find_twins
from palpate.views.catalogue.card import CardFacts, TwinNote
from palpate.views.catalogue.listing import print_listing
from palpate.views.catalogue.picture import draw_objects
from palpate.views.catalogue.results import name_out, pair_out, rig_out

__all__ = ["picture_beside", "run_objects_show"]

_LIKE = {
    Likeness.SAME: "feels like",
    Likeness.DOUBTFUL: "may feel like",
    Likeness.UNKNOWN: "as far as known like",
}


def run_objects_show(
    *,
    objects: Path,
    rig: Path | None,
    picture: Path | None,
    every: bool = False,
    json: bool = False,
    calibration: bool = True,
) -> int:
    """List, draw and print; returns the exit code, 0. An existing picture is written over.

    `every`: a long listing, with each state and pair for itself; JSON has them always.
    """
    fingers = rig_fingers(load_calibrated(rig, calibration=calibration).rig)
    states = state_sections(load_objects(objects))
    place = picture or picture_beside(objects)
    check_place(place)
    with Doing(Terminal(stderr=True, soft_wrap=True), f"comparing {len(states)} states") as doing:
        pairs = find_twins(states, fingers)
        doing.now("drawing")
        facts = {state: CardFacts(symmetry_of_state(state).order, _twins(state, pairs)) for state in states}
        drawing, left_out = draw_objects(objects.name, states, facts, fingers)
    write_text(place, drawing)
    out = ObjectsListingOut(
        objects=str(objects),
        rig=rig_out(fingers, shipped=rig is None),
        states=tuple(_listed(state, facts[state]) for state in states),
        twins=tuple(pair_out(pair) for pair in pairs),
        picture=str(place),
        left_out=tuple(name_out(state) for state in left_out),
    )
    if json:
        typer.echo(to_json(out))
    else:
        console = Terminal(highlight=False, markup=False, emoji=False, soft_wrap=True)
        print_listing(out, console, every=every)
    return 0


def picture_beside(objects: Path) -> Path:
    """Where the picture goes unless told: in the current folder, named so that no drawing is written over."""
    return Path(f"{objects.stem.removesuffix('.objects')}.objects.svg")


def _twins(state: StateSections, pairs: Sequence[Pair]) -> tuple[TwinNote, ...]:
    """Which states feel like one, or may; those that do for certain first."""
    others: dict[Likeness, list[str]] = {likeness: [] for likeness in _LIKE}
    for pair in pairs:
        if state in (pair.first.state, pair.second.state):
            other = (pair.second if pair.first.state is state else pair.first).state
            same_object = other.object_name == state.object_name
            others[pair.likeness].append(other.state.name if same_object else other.name)
    return tuple(TwinNote(_LIKE[likeness], tuple(names)) for likeness, names in others.items() if names)


def _listed(state: StateSections, facts: CardFacts) -> StateListedOut:
    edges = [level.edges for level in state.levels]
    found = state.state
    return StateListedOut(
        object=state.object_name,
        state=found.name,
        sections=len(state.levels),
        edges=(min(edges), max(edges)),
        top_mm=found.top_mm,
        heights_mm=found.heights_mm,
        symmetry_order=facts.symmetry_order,
        probability=found.probability,
        tipping_angle_rad=found.tipping_angle_rad,
        tolerance_mm=state.tolerance_mm,
    )
