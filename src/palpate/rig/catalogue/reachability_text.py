"""Reachability of a catalogue in words: one line per kind of problem, or a refusal before anything moves."""

from collections.abc import Sequence
from itertools import groupby

from palpate.base.errors import InputError, counted
from palpate.base.geometry import ObjectModel
from palpate.config import RigFile
from palpate.rig.catalogue.finger_model import at_heights, contact_bound_mm, heights_in_words
from palpate.rig.catalogue.oblique_touches import oblique_lines
from palpate.rig.catalogue.reachability import HOPELESS, OF_SECTION, Finding, Trouble, findings_of
from palpate.rig.catalogue.tip_lengths import overhang_lines
from palpate.rig.pads import refuse_parts_that_move

__all__ = ["finding_lines", "untouched_lines", "workspace_words"]

_SHOWN = 5
_UNITS = {
    1000.0: "if coordinates are metres, multiply them by 1000",
    25.4: "if coordinates are inches, multiply them by 25.4",
    1 / 25.4: "if mm were taken for inches, divide coordinates by 25.4",
    1 / 1000: "if mm were taken for metres, divide coordinates by 1000",
}


def finding_lines(rig: RigFile, models: Sequence[ObjectModel], name: str) -> list[str]:
    """What the operator should know of the objects of the file `name` before a run on a rig.

    Empty if all states can be felt by all fingers, and as what they are. Raises InputError if none can be by
    any, one is met by a ball too far from its equator, or is moved by pads.
    """
    refuse_parts_that_move(rig, models)
    found = findings_of(rig, models)
    lines = [_line(rig, group) for group in _groups(found)]
    states = sum(len(model.states) for model in models)
    if sum(finding.trouble in HOPELESS for finding in found) == states:
        raise InputError(f'{name}: rig "{rig.name}" cannot identify anything in it: {"; ".join(lines)}')
    lines += [*overhang_lines(rig, models), *oblique_lines(rig, models)]
    return [f"{name}: {line}" for line in lines]


def untouched_lines(rig: RigFile, models: Sequence[ObjectModel]) -> list[str]:
    """What to look at if fingers touched nothing, or hardly anything."""
    tops = sorted({state.top_mm for model in models for state in model.states})
    high = f"{tops[0]:.3g}" if len(tops) == 1 else f"{tops[0]:.3g} to {tops[-1]:.3g}"
    return [
        f"is a part on the table, and inside {workspace_words(rig)}?",
        f"do fingers pass above it? they are at {heights_in_words(at_heights(rig))}, "
        f"the catalogue's states are {high} mm high",
        "do the arrays feel it if they are pressed? `palpate watch` shows them",
    ]


def workspace_words(rig: RigFile) -> str:
    """The region where parts may lie."""
    return f"the workspace, a circle of {2 * rig.workspace.radius_mm:g} mm across round (0, 0)"


def _groups(found: Sequence[Finding]) -> list[list[Finding]]:
    """Those of which one line can tell."""

    def kind(item: Finding) -> tuple[str, float, tuple[str, ...]]:
        return item.trouble.name, item.scale or 0.0, item.fingers

    return [list(group) for _, group in groupby(sorted(found, key=kind), kind)]


def _line(rig: RigFile, group: Sequence[Finding]) -> str:
    first = group[0]
    line = f"{_names(group)}: {_reason(rig, first)}"
    return line if first.scale is None else f"{line}; {_UNITS[first.scale]}"


def _names(group: Sequence[Finding]) -> str:
    size = "across" if group[0].trouble in OF_SECTION else "high"
    shown = [
        f"{item.object_name}, {item.state_name} ({item.size_mm:.3g} mm {size})" for item in group[:_SHOWN]
    ]
    more = len(group) - len(shown)
    return "; ".join(shown) + (f" and {counted(more, 'more state', 'more states')}" if more else "")


def _reason(rig: RigFile, finding: Finding) -> str:
    heights = heights_in_words(at_heights(rig))
    match finding.trouble:
        case Trouble.MISSED:
            return f"nothing at the height of any finger, {heights}"
        case Trouble.SOME_FINGERS:
            return f"touched by {', '.join(finding.fingers)} only; fingers are at {heights}"
        case Trouble.LINKS:
            return "too high for the arms' links to pass above (links_height_mm)"
        case Trouble.OVERSIZED:
            return f"larger in all directions than {workspace_words(rig)}"
        case Trouble.STICKS_OUT:
            return f"too long for {workspace_words(rig)}: fingers may hit what sticks out of it"
        case Trouble.TINY:
            off_mm = 2 * (contact_bound_mm(rig) or 0.0)
            return f"smaller than {off_mm:.2g} mm, by which two touches may be off"
