"""The answer of `palpate identify` in words, with its alternatives, or the reason why there is none."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence

from palpate.base.errors import join_words, quantity
from palpate.base.vocabulary import BoundSource, ContradictionCause, IdentificationVerdict, SetUpFault
from palpate.config.fields import UnfinishedOut
from palpate.config.recognition_results import (
    AlternativeOut,
    CalibrationUsedOut,
    ContradictionOut,
    IdentificationOut,
    PartOut,
    PlacedOut,
    Relation,
    SetUpDoubtOut,
    TableOut,
    TruthOut,
)
from palpate.views.numerals import at_most, ceil_to, decimal, floor_to

_STRANGER_SIZE_MM = 100.0  # as large as a part: touches would rather have missed it
_MAX_ALTERNATIVES = 12
_MIN_PROBABILITY = 1e-4  # the model of what is not in the catalogue is no better than that
_RETOUCH_TIP = "`palpate check --touch` shows"


def answer_lines(out: IdentificationOut, advice: Sequence[str] = ()) -> list[str]:
    """The answer as lines for the terminal, compared with the truth if that is known.

    `advice`: what to check if hardly anything was touched (`untouched_lines`).
    """
    if out.table is not None:
        return _table_lines(out, out.table)
    lines = [*_verdict_lines(out), *(f"  {_doubt_words(item)}" for item in out.setup_doubts)]
    lines += [*place_lines(out), *_goal_lines(out)]
    if out.object is None and out.verdict == IdentificationVerdict.UNRESOLVED:
        lines += [f"  {line}" for line in advice]
    lines += [f"  {_alternative_line(other)}" for other in out.alternatives[:_MAX_ALTERNATIVES]]
    if len(out.alternatives) > _MAX_ALTERNATIVES:
        lines.append(f"  or one of {len(out.alternatives) - _MAX_ALTERNATIVES} more; the JSON lists them all")
    if out.verdict == IdentificationVerdict.IDENTIFIED and out.predicted:
        lines += [f"  {line}" for line in _confirmation_lines(out)]
    if out.verdict == IdentificationVerdict.UNRESOLVED and out.object is not None and _is_one_state(out):
        lines.append(f"  {_unconfirmed_words(out)}")
    lines += [*_motion_lines(out), *_not_bounded_lines(out)]
    if out.unfinished is not None:
        lines.append(f"  {_unfinished_words(out.unfinished)}")
    lines += [f"  {line}" for line in out.notices]
    if out.calibration is not None and out.calibration.drifted:
        lines.append(_drift_line(out.calibration))
    if out.truth is not None:
        lines += [_truth_line(out), *_other_truth_lines(out)]
    return lines


def headline(out: IdentificationOut) -> str:
    """The verdict, and the object only if it is the answer; else what there is instead of one."""
    if out.table is not None:
        return f"{out.verdict.value.capitalize()}: {_parts_words(out)}"
    name = f"{out.object}, {out.state}"
    match out.verdict:
        case IdentificationVerdict.IDENTIFIED:
            words = name
        case IdentificationVerdict.INDISTINGUISHABLE:
            count = len(out.alternatives)
            words = f"{name}, or {quantity(count, 'other', 'others')}" if count else f"{name}, or its like"
        case IdentificationVerdict.UNRESOLVED if out.object is not None:
            count = 1 + len(out.alternatives)
            words = f"only {name} is left" if count == 1 else f"{count} hypotheses left"
        case IdentificationVerdict.UNKNOWN:
            words = "nothing in the catalogue agrees"
        case _:
            words = "no object can be named"
    return f"{out.verdict.value.capitalize()}: {words}"


def part_answer(out: IdentificationOut, part: PartOut) -> IdentificationOut:
    """One of several parts as an answer by itself."""
    own = {
        name: getattr(part, name) for name in PartOut.model_fields if name in IdentificationOut.model_fields
    }
    common = {"parts": (), "table": None, "limit": None, "narrower_without": (), "motion_bounds": ()}
    return out.model_copy(update=common | own)


def _table_lines(out: IdentificationOut, table: TableOut) -> list[str]:
    """The parts that were found, a paragraph each, and what else may be on the table."""
    lines = [f"{out.verdict}: {_parts_words(out)}", *(f"  {line}" for line in table_notes(out, table))]
    for number, part in enumerate(out.parts, start=1):
        first, *others = answer_lines(part_answer(out, part))
        doubt = "" if part.agreed else " (some of its touches may be another part's)"
        lines += [f"part {number}, {first}{doubt}", *(f"  {line.strip()}" for line in others)]
    return [*lines, rest_words(table)]


def table_notes(out: IdentificationOut, table: TableOut) -> list[str]:
    """Notes on a table: what touches leave open, and what ended the run."""
    notes = []
    if not table.divisions:
        notes.append("the touches are not those of so many parts of the catalogue, wherever they lie")
    if table.divisions > 1:
        notes.append(f"touches may be those of one part or another in {table.divisions} ways")
    if out.limit:
        notes.append(f"ended by {out.limit} of the rig file")
    return notes


def rest_words(table: TableOut) -> str:
    """What else may be on a table."""
    low, high = table.rest_heights
    heights = f"{low:g} mm" if low == high else f"{low:g} to {high:g} mm"
    return (
        f"elsewhere, {heights} above the table, nothing is left into which a circle of "
        f"{2 * ceil_to(table.rest_radius, 1):.1f} mm in diameter fits"
    )


def _parts_words(out: IdentificationOut) -> str:
    """The parts of a table in a few words."""
    assert out.table is not None, "only called for tables"
    names = [str(part.object) for part in out.parts if part.verdict.is_answer and part.agreed]
    named = [f"{count} × {name}" if count > 1 else name for name, count in Counter(names).items()]
    others = len(out.parts) - len(names)
    more = [f"{quantity(others, 'part', 'parts')} not named"] if others else []
    missing = "" if out.table.complete or not out.table.divisions else "; there may be more"
    return (join_words([*named, *more]) or "no part can be named") + missing


def _confirmation_lines(out: IdentificationOut) -> list[str]:
    """Say how well an answer is confirmed: against what else, and against a shift."""
    lines = [f"{quantity(out.predicted, 'touch', 'touches')} matched the prediction"]
    if out.stranger_probability is not None:
        lines.append(_stranger_words(out.stranger_probability))
    if out.altered_probability is not None:
        lines.append(_feature_words(out.altered_probability))
    if out.detectable_shift is not None or out.assumed_holds_n is None:
        lines.append(_shift_words(out.detectable_shift))
    return lines


def _unfinished_words(unfinished: UnfinishedOut) -> str:
    parts = []
    if unfinished.unpaired:
        parts.append(
            f"{quantity(len(unfinished.unpaired), 'contact is', 'contacts are')} not paired with edges"
        )
    parts += ["cells are coarse"] if unfinished.coarse else []
    return (
        f"search.budget of {unfinished.budget} units spent: {', '.join(parts)}; "
        "the answer and its bounds hold, a larger budget may narrow them"
    )


def picture_facts(out: IdentificationOut) -> list[tuple[str, str]]:
    """Rows for the picture's panel; nothing that differs between two runs of one seed."""
    rows = [
        ("grips", str(out.grips)),
        ("touches", str(out.touches)),
        ("matched the prediction", str(out.predicted)),
        ("strategy", str(out.strategy)),
        ("rig time", f"{out.rig_seconds:.1f} s"),
        ("devices", "emulated" if out.emulated else "hardware"),
    ]
    if out.table is not None:
        return [rows[0], rows[1], *rows[3:], *(row for part in out.parts for row in _part_facts(part))]
    if out.symmetry_order > 1:
        rows.append(("symmetry", f"{out.symmetry_order}-fold: θ modulo {360 / out.symmetry_order:g}°"))
    if out.symmetry_order == 0:
        rows.append(("symmetry", "round: θ is any"))
    if out.truth is not None and out.truth.named:
        off, turned = out.truth.position_error_mm or 0.0, math.degrees(out.truth.orientation_error_rad or 0.0)
        rows.append(("off the truth", f"{off:.2f} mm, {turned:.2f}°"))
    return rows


def _part_facts(part: PartOut) -> list[tuple[str, str]]:
    """Place of one of several parts, with the half-widths of its bounds."""
    if part.configuration is None or part.bounds is None:
        return [("a part", part.verdict.value)]
    at, bounds, name = part.configuration, part.bounds, str(part.object)
    rows = [(f"{name}, x, y", f"{_plus_minus(at.x, bounds.x)}, {_plus_minus(at.y, bounds.y)} mm")]
    lo, hi = map(math.degrees, bounds.theta)
    turn = f"{_plus_minus(math.degrees(at.theta), (lo, hi))}°" if part.symmetry_order else "any"
    return [*rows, (f"{name}, θ", turn)]


def _plus_minus(value: float, bounds: tuple[float, float]) -> str:
    """A value with a half-width that holds for it as printed."""
    shown, (lo, hi) = round(value, 1), bounds
    return f"{decimal(shown, 1)} ± {at_most(max(hi - shown, shown - lo), 1)}"


def _share(probability: float) -> str:
    if probability < _MIN_PROBABILITY:
        return f"less than {100 * _MIN_PROBABILITY:g} %"
    return f"{100 * probability:.2g} %"


def _stranger_words(probability: float) -> str:
    """How probably something that differs by as much as the model calls different would have matched."""
    return (
        "something that differs by 2 mm over a fifth of its outline would have matched, too, "
        f"with probability {_share(probability)}"
    )


def _feature_words(probability: float) -> str:
    """The same of what differs by less."""
    return f"something that differs by 2 mm in one feature only, with probability {_share(probability)}"


def _is_one_state(out: IdentificationOut) -> bool:
    """True if all that is left is one state of one object, in one or several places."""
    return all((other.object, other.state) == (out.object, out.state) for other in out.alternatives)


def _unconfirmed_words(out: IdentificationOut) -> str:
    """Why the only state that is left is no answer yet."""
    matched = f"{quantity(out.predicted, 'touch', 'touches')} matched the prediction"
    if out.stranger_probability is None:
        return f"not confirmed: {matched}"
    return f"not confirmed: {matched}, but {_stranger_words(out.stranger_probability)}"


def place_lines(out: IdentificationOut) -> list[str]:
    """Configuration with its bounds, rounded outward, a line for each coordinate."""
    if out.configuration is None or out.bounds is None:
        return []
    at, bounds = out.configuration, out.bounds
    degrees = [math.degrees(value) for value in bounds.theta]
    x, y, theta = (
        f"in [{floor_to(lo, 3):.3f}, {ceil_to(hi, 3):.3f}]" for lo, hi in (bounds.x, bounds.y, degrees)
    )
    lines = [
        f"  x  {at.x:9.3f} mm   {x}",
        f"  y  {at.y:9.3f} mm   {y}",
        f"  θ  {math.degrees(at.theta):9.3f} °    {theta}"
        if out.symmetry_order
        else "  θ        any      (round)",
    ]
    if out.symmetry_order > 1:
        lines.append(f"  ({out.symmetry_order}-fold symmetric: θ modulo {360 / out.symmetry_order:g}°)")
    return lines


def _goal_lines(out: IdentificationOut) -> list[str]:
    """Say that the goal was missed, and which limit ended the run."""
    if out.goal_met is False:
        ended = f": the run came to {out.limit}" if out.limit else ""
        return [f"  wider than the rig file's goal{ended}", *_narrower_lines(out)]
    if out.limit and out.verdict is IdentificationVerdict.UNRESOLVED:
        return [f"  ended by {out.limit} of the rig file"]
    return []


_SOURCE_WORDS = {
    BoundSource.FINGERS: "if fingers were where they are thought to be",
    BoundSource.DENTS: "if dents of tips were known",
    BoundSource.NORMALS: "if arrays measured normals exactly",
    BoundSource.MOTION: "if the part could not move",
    BoundSource.TOLERANCE: "if the part were as drawn",
}
_SOURCES_SHOWN = 2


def _narrower_lines(out: IdentificationOut) -> list[str]:
    """What would have narrowed the bounds most."""
    return [
        f"  ±{item.position:.2f} mm, ±{math.degrees(item.orientation):.2f}° {_SOURCE_WORDS[item.source]}"
        for item in out.narrower_without[:_SOURCES_SHOWN]
    ]


def _verdict_lines(out: IdentificationOut) -> list[str]:
    """The verdict with the object, or the reason why none is named."""
    if out.object is None and out.verdict == IdentificationVerdict.UNKNOWN:
        lines = [f"{out.verdict}: no object of the catalogue agrees with the contacts"]
        lines += [f"  {line}" for line in _motion_doubt_words(out)]
        if out.calibration is not None:
            made = out.calibration.made[:10]
            lines.append(f"  or the rig has changed since its calibration of {made}: {_RETOUCH_TIP}")
        return lines
    if out.object is None:
        moving = out.verdict == IdentificationVerdict.MOVING
        return [f"{out.verdict}: {_moving_words(out) if moving else _untouched_words(out)}"]
    name = f"{out.object}, {out.state}"
    if out.verdict == IdentificationVerdict.MOVING:
        return [f"{out.verdict}: {_moving_words(out)}; by grip {_last(out)} alone it may be {name}"]
    if out.verdict == IdentificationVerdict.UNRESOLVED:
        left = (
            "is the only one that agrees with the contacts" if not out.alternatives else "is still possible"
        )
        lines = [f"{out.verdict}: {name} {left}"]
    elif out.verdict == IdentificationVerdict.INDISTINGUISHABLE:
        lines = [f"{out.verdict}: {_alike_words(out, name)}"]
    else:
        lines = [f"{out.verdict}: {name}"]
    if out.moved_before:
        lines.append(f"  moved before grip {_last(out)}; touches since then count")
    return lines


def _motion_doubt_words(out: IdentificationOut) -> list[str]:
    """Say whether what agrees with nothing may be a part of the catalogue that was moved."""
    last = out.contradictions[-1] if out.contradictions else None
    if last is not None and last.cause is ContradictionCause.NOT_IN_CATALOGUE:
        still = f"as far as touches show, it lay still: {_again_words(last)}"
        return [f"{still}; add it to the catalogue, or lay down another part"]
    if last is not None and last.cause is ContradictionCause.EITHER:
        again = "" if last.repeated_in is None else f": {_again_words(last)}"
        return [f"or it moved before grip {last.grip}{again}; hold it, and run again"]
    if out.moved_before:
        return [f"or it was moved again: it seems to have been moved before grip {_last(out)}"]
    return []


def _again_words(item: ContradictionOut) -> str:
    """What became of touches that were made again."""
    if item.apart is None:
        return (
            f"a touch made again in grip {item.repeated_in} met nothing where it had before, or the reverse"
        )
    touches = quantity(item.touches, "touch", "touches")
    if item.cause is ContradictionCause.MOVED:
        return f"of {touches} made again in grip {item.repeated_in} one stopped {item.apart:.1f} mm elsewhere"
    where = f"within {item.apart:.1f} mm of where they had"
    return f"{touches} made again in grip {item.repeated_in} stopped {where}"


def _alike_words(out: IdentificationOut, name: str) -> str:
    """What is left, where no touch distinguishes it: one object in some of its states, or several objects."""
    states = list(dict.fromkeys([out.state, *(item.state for item in out.alternatives)]))
    named = f"{out.object}, {' or '.join(map(str, states))}"
    near = [item.relation is Relation.NEAR for item in out.alternatives]
    if all(near):
        return f"{named}: at the same place, as finely as the rig file asks"
    if len(states) > 1 and all(item.object == out.object for item in out.alternatives):
        ones = "those that are not at the same place" if any(near) else "these"
        return f"{named}: no touch within reach distinguishes {ones}"
    return f"{name}, or something that no touch within reach distinguishes from it"


def _moving_words(out: IdentificationOut) -> str:
    """Say that the part moves, how that is known, and what to do."""
    grips = ", ".join(map(str, out.moved_before))
    shown = [item for item in out.contradictions if item.cause is ContradictionCause.MOVED]
    if shown:
        how = f"it was moved (before grips {grips}): {_again_words(shown[-1])}"
    else:
        how = f"fingers may have moved the part too far to go on (before grips {grips})"
    return f"{how}; hold it, or touch more lightly"


_FAULTS: Mapping[SetUpFault, tuple[str, str]] = {
    SetUpFault.ARRAY_MIRRORED: ("the array of {whose} is mirrored or upside down", "check --press"),
    SetUpFault.ARRAY_TURNED: ("the array of {whose} is turned by {deg}° on its tip", "check --press"),
    SetUpFault.ARRAY: (
        "the array of {whose} is touched elsewhere than it says (array.heading_deg, its order of taxels)",
        "check --press",
    ),
    SetUpFault.JOINT_SIGN: ("{joint}.gear_ratio of {whose} has the wrong sign", "check --move"),
    SetUpFault.JOINT_OFFSET: (
        "the {joint} of {whose} stands {off} further than the rig file says (its zero, its horn or a Homing "
        "Offset, base_mm, heading_deg)",
        "calibrate",
    ),
    SetUpFault.TRAVEL_SCALE: ("mm_per_turn of {whose} is {factor} times as large", "check --move"),
    SetUpFault.FRAME_MIRRORED: ("places were measured with the y axis the wrong way round", "check --move"),
    SetUpFault.TIP_SIZE: (
        "the tip of {whose} is {factor} times as large (radius for diameter?)",
        "calibrate",
    ),
}


def _doubt_words(doubt: SetUpDoubtOut) -> str:
    """A hint at what may be wrong with the set-up, and what shows whether it is."""
    if doubt.what is SetUpFault.FINGER:
        return (
            f"or something is wrong with {doubt.finger}: the {doubt.explains} contacts of the other fingers "
            f"agree with a part of the catalogue, and those of {doubt.finger} contradict them; "
            "`palpate check --press` and `palpate calibrate` show"
        )
    words, shown_by = _FAULTS[doubt.what]
    lo, hi = doubt.value or (0.0, 0.0)
    off = f"{lo:.1f} to {hi:.1f} mm"
    if doubt.what is SetUpFault.JOINT_OFFSET and doubt.joint != "slide":
        off = f"{math.degrees(lo):.1f} to {math.degrees(hi):.1f}°"
    fault = words.format(
        whose=doubt.finger or "every finger",
        joint=doubt.joint,
        deg=f"{math.degrees(lo):g}",
        off=off,
        factor=f"{lo:.3g}",
    )
    return (
        f"or the rig is not as its file says: all {doubt.explains} contacts agree with a part of the "
        f"catalogue if {fault}; `palpate {shown_by}` shows"
    )


def _motion_lines(out: IdentificationOut) -> list[str]:
    """Say on what the bounds rest, if a force is declared, and what speaks against it."""
    if out.assumed_holds_n is None:
        return []
    held = f"{out.assumed_holds_n:g} N"
    lines = []
    furthest = [bound.position for bound in out.motion_bounds if bound.position is not None]
    if len(furthest) < len(out.motion_bounds):
        lines.append(f"  fingers may push a part that holds {held} without a bound: touch more lightly")
    elif furthest:
        most = math.degrees(max(bound.orientation or 0.0 for bound in out.motion_bounds))
        lines.append(
            f"  bounds assume that the part holds {held}: then a grip moved it {max(furthest):.2f} mm and "
            f"{most:.2f}° at most"
        )
    if out.hold_contradicted and out.verdict is not IdentificationVerdict.UNKNOWN:
        lines.append(f"  it moved further than a part that holds {held} can: does it hold less?")
    return lines


def _not_bounded_lines(out: IdentificationOut) -> list[str]:
    """Say that bounds do not hold if the part has tipped or rolled."""
    if not out.not_bounded:
        return []
    first, others = out.not_bounded[0], len(out.not_bounded) - 1
    more = f" (and {quantity(others, 'other state', 'other states')}, which the JSON lists)" if others else ""
    return [
        f"  no bound holds for a part that tips or rolls: {first.object}, {first.state} {first.why}{more}"
    ]


def _untouched_words(out: IdentificationOut) -> str:
    """Why there is no hypothesis."""
    if out.swept:
        since = f" since grip {_last(out)}" if out.moved_before else ""
        return (
            f"nothing was touched{since}, and no part of the catalogue has room in the rest of the workspace"
        )
    if out.contradictions:
        return f"grip {out.contradictions[-1].grip} contradicts earlier ones: {_open_words(out)}"
    if not out.contacts:
        return f"nothing was touched in {quantity(out.grips, 'grip', 'grips')}"
    return f"{quantity(out.contacts, 'contact is', 'contacts are')} too few for a hypothesis"


def _open_words(out: IdentificationOut) -> str:
    """What the grip that contradicts earlier ones may mean, where the run ended with it."""
    last = out.contradictions[-1]
    if last.cause is ContradictionCause.MOVED:
        return f"it was moved: {_again_words(last)}; hold it, and run again"
    return "it is not in the catalogue, or was moved; hold it, and allow more grips"


def _drift_line(found: CalibrationUsedOut) -> str:
    """Warning: touches do not agree with the calibration."""
    return (
        f"  touches differ by {found.residual_rms_mm:.3f} mm, the calibration of {found.made[:10]} lets "
        f"expect {found.expected_rms_mm:.3f}: the rig may have changed, or the part gave way; {_RETOUCH_TIP}"
    )


def _last(out: IdentificationOut) -> int:
    return out.moved_before[-1]


def _alternative_line(other: AlternativeOut) -> str:
    at = other.configuration
    where = f"x {at.x:.2f} mm, y {at.y:.2f} mm, θ {math.degrees(at.theta):.2f}°"
    if other.turned is None or other.moved is None:
        return f"or {other.object}, {other.state} at {where}"
    return f"or turned by {math.degrees(other.turned):.1f}° and moved by {other.moved:.1f} mm: {where}"


def _other_truth_lines(out: IdentificationOut) -> list[str]:
    """A line for each part that lies beside the one of `_truth_line`."""
    assert out.truth is not None, "only called with a truth"
    return [f"  beside it: {_placement_words(item)}" for item in out.truth.others]


def _placement_words(item: PlacedOut | TruthOut) -> str:
    at = item.configuration
    return f"{item.object}, {item.state} at x {at.x:.3f} mm, y {at.y:.3f} mm, θ {math.degrees(at.theta):.3f}°"


def _truth_line(out: IdentificationOut) -> str:
    truth = out.truth
    assert truth is not None, "only called with a truth"
    line = f"emulator's truth: {_placement_words(truth)}"
    if not truth.named or truth.position_error_mm is None or truth.orientation_error_rad is None:
        return f"{line}; not among the answers"
    turned = math.degrees(truth.orientation_error_rad)
    whose = "" if (truth.object, truth.state) == (out.object, out.state) else "that hypothesis is "
    return (
        f"{line}; {whose}off by {truth.position_error_mm:.3f} mm and {turned:.3f}°, "
        f"{'inside' if truth.inside_bounds else 'OUTSIDE'} the bounds"
    )


def _shift_words(shift_mm: float | None) -> str:
    if shift_mm is None or shift_mm > _STRANGER_SIZE_MM:
        return "a shift of the part before the last grip would hardly have been detected"
    return f"smallest detectable shift before the last grip: {shift_mm:.1f} mm"
