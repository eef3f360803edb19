"""Grips of a run in a report: a picture of what was known after each, what was touched, and what fell."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from palpate.base.errors import counted
from palpate.base.geometry import ObjectModel
from palpate.base.vocabulary import TipShape
from palpate.config import RigFile
from palpate.rig.session.run_record import GripRecord, places_touched
from palpate.views.logged_hypotheses import heaviest_first, outlines_in_w
from palpate.views.report.page import columns, paragraph, picture, section, table
from palpate.views.table_picture.picture import draw
from palpate.views.table_picture.values import BoundedPose, FingerBase, OtherHypothesis, Picture, TouchMark

__all__ = ["grip_sections", "name_of"]

_DRAWN = 8  # hypotheses in a picture
_LISTED = 20
_POINTS = (
    "Of a pad the touched points of its face are listed, each with its own bound and with how far to the "
    "left of the face's middle it is, and of its misses the middle of the face. It measures no normal."
)


def grip_sections(
    grips: Sequence[GripRecord], rig: RigFile, objects: Sequence[ObjectModel], truth: Mapping[str, Any] | None
) -> list[str]:
    """A section for each grip."""
    models = {model.name: model for model in objects}
    found, before = [], None
    for at, grip in enumerate(grips):
        marks = tuple(_mark(item.number, touch) for item in grips[: at + 1] for touch in item.touches)
        parts = [picture(_picture(grip, marks, rig, models, truth))] if grip.touches else []
        parts.append(columns(_touches(grip), _hypotheses(grip)))
        parts += [paragraph(_POINTS)] if any(map(_is_of_pad, grip.touches)) else []
        parts.append(paragraph(_words(grip, before)))
        found.append(section(f"Grip {grip.number}", *parts, kind="grip"))
        before = grip if grip.verdict is not None else before
    return found


def name_of(item: Mapping[str, Any]) -> str:
    """Object and state of a hypothesis."""
    return f"{item['object']}, {item['state']}"


def _words(grip: GripRecord, before: GripRecord | None) -> str:
    """Why the grip was made, and what it changed."""
    words = [_kind(grip, before)]
    if grip.is_moved:
        words.append(
            "Earlier grips no longer count: it contradicts them, or fingers may have moved the part too far."
        )
    if grip.verdict is None:
        return " ".join([*words, "Its contacts were not interpreted."])
    left = {name_of(item) for item in grip.hypotheses}
    if before is not None:
        fell = sorted({name_of(item) for item in before.hypotheses} - left)
        words.append(f"Ruled out: {'; '.join(fell)}." if fell else "It ruled out no state.")
    words.append(f"Left: {counted(len(grip.hypotheses), 'hypothesis', 'hypotheses')}.")
    return " ".join(words)


def _kind(grip: GripRecord, before: GripRecord | None) -> str:
    if grip.planned is None:
        return "An exploring grip: too little was known for a plan."
    if before is not None and len(before.hypotheses) == 1:
        return "A grip that narrows the only hypothesis, or confirms it: does it predict the contacts?"
    if grip.planned["decisive"]:
        return "A planned grip, decisive: whatever it finds, hypotheses fall."
    return "A planned grip: what it is expected to find rules out most."


def _title(grip: GripRecord, first: Mapping[str, Any] | None) -> str:
    """What the contacts say."""
    if grip.verdict is None:
        return "not interpreted"
    return "nothing agrees" if first is None else name_of(first)


def _touches(grip: GripRecord) -> str:
    rows = []
    for touch in grip.touches:
        force = (touch.get("patch") or {}).get("force_n")
        for contact in places_touched(touch):
            x, y = contact["end_mm"]
            rows.append(
                (
                    contact["name"],
                    "touched" if contact["touched"] else "missed",
                    f"{x:.2f}",
                    f"{y:.2f}",
                    f"± {math.ceil(100 * contact['position_bound_mm']) / 100:.2f}",
                    _normal(contact.get("normal")),
                    "" if force is None else f"{force:.2f}",
                )
            )
    names = ("finger", "", "x, mm", "y, mm", "bound, mm", "normal, °", "force, N")
    return table(names, rows, names[2:])


def _normal(normal: Mapping[str, float] | None) -> str:
    if normal is None:
        return ""
    lo, hi = math.degrees(normal["lo_rad"]), math.degrees(normal["hi_rad"])
    return f"{(lo + hi) / 2 % 360:.0f} ± {(hi - lo) / 2:.0f}"


def _hypotheses(grip: GripRecord) -> str:
    heaviest = heaviest_first(grip.hypotheses)
    rows = []
    for item in heaviest[:_LISTED]:
        at = item["configuration"]
        theta = "any" if item["symmetry_order"] == 0 else f"{math.degrees(at['theta_rad']):.1f}"
        weight = 100 * (item["weight"] or 0.0)
        rows.append((name_of(item), f"{weight:.1f}", f"{at['x_mm']:.2f}", f"{at['y_mm']:.2f}", theta))
    if len(heaviest) > _LISTED:
        rows.append((f"and {len(heaviest) - _LISTED} more", "", "", "", ""))
    return table(("hypothesis", "%", "x, mm", "y, mm", "θ, °"), rows, ("%", "x, mm", "y, mm", "θ, °"))


def _picture(
    grip: GripRecord,
    marks: tuple[TouchMark, ...],
    rig: RigFile,
    models: Mapping[str, ObjectModel],
    truth: Mapping[str, Any] | None,
) -> str:
    heaviest = heaviest_first(grip.hypotheses)
    first = heaviest[0] if heaviest else None
    others = [
        OtherHypothesis(item["object"], f"still possible, {100 * (item['weight'] or 0):.0f} %", rings)
        for item in heaviest[1:_DRAWN]
        if (rings := outlines_in_w(item, models))
    ]
    return draw(
        Picture(
            title=f"After grip {grip.number}: {_title(grip, first)}",
            found=() if first is None else outlines_in_w(first, models),
            pose=None if first is None else _pose(first),
            truth=() if truth is None else outlines_in_w(truth, models),
            others=tuple(others),
            touches=marks,
            bases=tuple(FingerBase(item.name, item.base_mm) for item in rig.fingers),
            workspace_radius_mm=rig.workspace.radius_mm,
        )
    )


def _mark(number: int, touch: Mapping[str, Any]) -> TouchMark:
    contact, is_pad = touch["contact"], _is_of_pad(touch)
    normal = None if is_pad else contact.get("normal")
    return TouchMark(
        contact["name"],
        number,
        tuple(contact["start_mm"]),
        tuple(contact["end_mm"]),
        contact["finger"]["tip_radius_mm"],
        contact["touched"],
        None if normal is None else (normal["lo_rad"], normal["hi_rad"]),
        is_pad,
        tuple(tuple(item["end_mm"]) for item in places_touched(touch) if is_pad and item["touched"]),
    )


def _is_of_pad(touch: Mapping[str, Any]) -> bool:
    return bool(touch["contact"]["finger"].get("shape") == TipShape.PAD)


def _pose(item: Mapping[str, Any]) -> BoundedPose:
    at, bounds = item["configuration"], item["bounds"]
    x, y, theta = ((at[name], *bounds[name]) for name in ("x_mm", "y_mm", "theta_rad"))
    return BoundedPose(x, y, theta)
