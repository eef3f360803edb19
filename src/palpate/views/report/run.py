"""Report of a run: verdict and bounds, each grip, rejected alternatives, timing, devices, settings."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from palpate.base.errors import InputError, quantity
from palpate.base.geometry import ObjectModel
from palpate.base.vocabulary import SessionKind
from palpate.config import RigFile
from palpate.config.recognition_results import IdentificationOut
from palpate.config.session_results import SessionOut
from palpate.drivers.transport import PortOpened
from palpate.recognizer import Catalogue, NormalRange, explain_object
from palpate.rig.session.log_reader import SessionFile
from palpate.rig.session.logged_values import (
    GripRecord,
    LoggedPlacement,
    by_part,
    grip_records,
    placements_in,
)
from palpate.rig.session.recorded_session import SessionSamples
from palpate.views.answer import answer_lines, headline, part_answer, place_lines, rest_words, table_notes
from palpate.views.numerals import at_least, at_most, decimal
from palpate.views.recognition import ContactRecord, bounded_pose, touch_mark, why_lines
from palpate.views.report.page import (
    bullets,
    columns,
    heading,
    lines,
    page,
    paragraph,
    picture,
    section,
    table,
)
from palpate.views.run_scene import heaviest, outlines_in_w
from palpate.views.sessions_text import answer_words, info_lines, instant_words
from palpate.views.table_picture.picture import draw
from palpate.views.table_picture.values import FingerBase, OtherHypothesis, Picture, TouchMark

_MAX_DRAWN = 8  # hypotheses in a picture
_MAX_LISTED = 20
_POINT_ROWS = (
    "Of a pad the touched points of its face are listed, each with its own bound and with how far to the "
    "left of the face's middle it is, and of its misses the middle of the face. It measures no normal."
)


def _grip_sections(
    grips: Sequence[GripRecord],
    rig: RigFile,
    objects: Sequence[ObjectModel],
    truths: Sequence[LoggedPlacement],
    has_legend: bool,
) -> list[str]:
    """A section for each grip; `has_legend`: no picture before has one."""
    models = {model.name: model for model in objects}
    found, before = [], None
    for at, grip in enumerate(grips):
        marks = tuple(
            touch_mark(touch.grip, touch.contact, touch.touched_points)
            for item in grips[: at + 1]
            for touch in item.touches
        )
        drawn = replace(_picture(grip, marks, rig, models, truths), has_legend=has_legend)
        parts = [picture(draw(drawn))] if grip.touches else []
        has_legend = has_legend and not parts
        parts.append(columns(_touches(grip), "" if grip.is_chosen else _hypotheses(grip)))
        has_face = any(touch.contact.finger.tip.has_face for touch in grip.touches)
        parts += [paragraph(_POINT_ROWS)] if has_face else []
        parts += [paragraph(words)] if (words := _words(grip, before)) else []
        found.append(section(f"Grip {grip.number}", *parts, kind="grip"))
        before = grip if grip.verdict is not None else before
    return found


def _words(grip: GripRecord, before: GripRecord | None) -> str:
    """Why the grip was made, and what it changed."""
    if grip.is_chosen:
        return ""
    words = [_kind(grip, before)]
    if grip.is_moved:
        words.append(
            "Earlier grips no longer count: it contradicts them, or fingers may have moved the part too far."
        )
    if grip.verdict is None:
        return " ".join([*words, "Its contacts were not interpreted."])
    left = {item.name for item in grip.hypotheses}
    if grip.divisions is not None:
        ways = quantity(grip.divisions, "way", "ways")
        return " ".join([*words, f"{ways} to divide the touches among parts left."])
    if before is not None:
        fell = sorted({item.name for item in before.hypotheses} - left)
        words.append(f"Ruled out: {'; '.join(fell)}." if fell else "It ruled out no state.")
    words.append(f"Left: {quantity(len(grip.hypotheses), 'hypothesis', 'hypotheses')}.")
    return " ".join(words)


def _kind(grip: GripRecord, before: GripRecord | None) -> str:
    if grip.decisive is None:
        return "An exploring grip: too little was known for a plan."
    if grip.divisions is not None:
        return "A planned grip: it tells a part from others, places it more finely, or confirms it."
    if before is not None and len(before.hypotheses) == 1:
        return "A grip that narrows the only hypothesis, or confirms it: does it predict the contacts?"
    if grip.decisive:
        return "A planned grip, decisive: whatever it finds, hypotheses fall."
    return "A planned grip: what it is expected to find rules out most."


def _title(grip: GripRecord) -> str:
    """Return what the contacts say."""
    if grip.is_chosen:
        touched = sum(touch.contact.touched for touch in grip.touches)
        return f"{touched} of {quantity(len(grip.touches), 'finger', 'fingers')} touched"
    if grip.verdict is None:
        return "not interpreted"
    parts = by_part(grip.hypotheses)
    said = [f"only {own[0].name} is left" if len(own) == 1 else f"{len(own)} hypotheses" for own in parts]
    if grip.divisions is not None:
        said = [f"part {own[0].part}: {words}" for own, words in zip(parts, said, strict=True)]
    return "; ".join(said) or "nothing agrees"


def _touches(grip: GripRecord) -> str:
    rows = [
        (
            contact.name,
            "touched" if contact.touched else "missed",
            f"{contact.end_mm[0]:.2f}",
            f"{contact.end_mm[1]:.2f}",
            f"± {at_most(contact.position_bound_mm)}",
            _normal(contact.normal),
            "" if touch.force_n is None else f"{touch.force_n:.2f}",
        )
        for touch in grip.touches
        for contact in touch.places
    ]
    names = ("finger", "", "x, mm", "y, mm", "bound, mm", "normal, °", "force, N")
    return table(names, rows, names[2:])


def _normal(normal: NormalRange | None) -> str:
    if normal is None:
        return ""
    lo, hi = math.degrees(normal.lo_rad), math.degrees(normal.hi_rad)
    return f"{(lo + hi) / 2 % 360:.0f} ± {(hi - lo) / 2:.0f}"


def _hypotheses(grip: GripRecord) -> str:
    listed = heaviest(grip.hypotheses, _MAX_LISTED)
    rows = [
        (
            item.name if grip.divisions is None else f"{item.part}: {item.name}",
            f"{100 * item.weight:.1f}",
            f"{item.configuration.x_mm:.2f}",
            f"{item.configuration.y_mm:.2f}",
            f"{math.degrees(item.configuration.theta_rad):.1f}" if item.symmetry_order else "any",
        )
        for item in listed
    ]
    if len(grip.hypotheses) > len(listed):
        rows.append((f"and {len(grip.hypotheses) - len(listed)} more", "", "", "", ""))
    name = "hypothesis" if grip.divisions is None else "part: hypothesis"
    return table((name, "%", "x, mm", "y, mm", "θ, °"), rows, ("%", "x, mm", "y, mm", "θ, °"))


def _picture(
    grip: GripRecord,
    marks: tuple[TouchMark, ...],
    rig: RigFile,
    models: Mapping[str, ObjectModel],
    truths: Sequence[LoggedPlacement],
) -> Picture:
    only = [own[0] for own in by_part(grip.hypotheses) if len(own) == 1]
    placed = only[0] if len(grip.hypotheses) == 1 else None
    others = [
        OtherHypothesis(item.object, f"still possible, {100 * item.weight:.0f} %", rings)
        for item in heaviest(grip.hypotheses, _MAX_DRAWN)
        if item not in only and (rings := outlines_in_w(item, models))
    ]
    return Picture(
        title=f"After grip {grip.number}: {_title(grip)}",
        found=tuple(ring for item in only for ring in outlines_in_w(item, models)),
        pose=None if placed is None else bounded_pose(placed.configuration, placed.bounds),
        truth=tuple(ring for item in truths for ring in outlines_in_w(item, models)),
        others=tuple(others),
        touches=marks,
        bases=tuple(FingerBase(item.name, item.base_mm) for item in rig.fingers),
        workspace_radius_mm=rig.workspace.radius_mm,
    )


_MAX_RIVALS_EXPLAINED = 40  # rivals whose elimination is explained; more would take minutes


def run_report(samples: SessionSamples, summary: SessionOut, folder: Path) -> str:
    """The page. A run that was cut off is reported as far as its log goes."""
    file, grips = samples.file, grip_records(samples.file)
    told = file.told("truth")
    truths = placements_in(told[0]) if told else ()
    answer = _answer(file)
    title = headline(answer) if answer else _title_without_answer(summary)
    has_picture = answer is not None and (folder / "picture.svg").is_file()
    parts = [
        heading(
            f"{title} – rig {summary.rig or '?'}",
            f"{Path(summary.path).name}, {instant_words(summary.began)}",
        ),
        section("Answer", *_answer_parts(answer, summary, folder)),
        *_part_sections(answer),
        *_grip_sections(grips, samples.rig, samples.objects, truths, not has_picture),
        # Of several parts the log does not say which touches are whose.
        *(
            []
            if (answer and answer.table) or any(grip.is_chosen for grip in grips)
            else [section("Why each rival fell", _rivals(grips, samples.objects))]
        ),
        section("Timing", _timing(grips, summary)),
        section("Devices", _devices(samples.rig, file)),
        section("Calibration", _calibration(answer, summary)),
        section("Versions", _versions(file, summary)),
        section("Rig file", lines(_read(folder / "rig.toml")), kind="settings"),
    ]
    return page(title, parts)


def _title_without_answer(summary: SessionOut) -> str:
    words = answer_words(summary)
    return "No answer" if summary.command == SessionKind.IDENTIFY else f"{words[0].upper()}{words[1:]}"


def _answer(file: SessionFile) -> IdentificationOut | None:
    results = file.told("result")
    return IdentificationOut.model_validate(results[-1]["result"]) if results else None


def _answer_parts(answer: IdentificationOut | None, summary: SessionOut, folder: Path) -> Iterator[str]:
    if answer is None:
        if summary.command == SessionKind.IDENTIFY:
            yield paragraph("The run ended before there was an answer.")
        yield lines("\n".join(info_lines(summary)))
    elif answer.table is None:
        yield from _place_and_notes(answer)
    else:
        yield bullets([*table_notes(answer, answer.table), rest_words(answer.table)])
    drawn = folder / "picture.svg"
    if drawn.is_file():
        yield picture(_read(drawn))


def _part_sections(answer: IdentificationOut | None) -> Iterator[str]:
    """A section for each of several parts."""
    if answer is None:
        return
    for number, part in enumerate(answer.parts, start=1):
        one = part_answer(answer, part)
        yield section(f"Part {number}, {headline(one).lower()}", *_place_and_notes(one))


def _place_and_notes(answer: IdentificationOut) -> Iterator[str]:
    placed = place_lines(answer)
    if placed:
        yield _place_table(answer)
    said = [line.strip() for line in answer_lines(answer) if line not in placed]
    yield bullets(line for line in said if line != headline(answer).lower())


def _place_table(answer: IdentificationOut) -> str:
    """The configuration with its bounds, and the truth of an emulated table."""
    at, bounds, truth = answer.configuration, answer.bounds, answer.truth
    assert at is not None, "only called with a place"
    assert bounds is not None, "only called with a place"
    real = truth.configuration if truth is not None and truth.named else None
    rows = []
    for name, unit, factor in (("x", "mm", 1.0), ("y", "mm", 1.0), ("theta", "°", math.degrees(1.0))):
        value, (lo, hi) = factor * getattr(at, name), (factor * end for end in getattr(bounds, name))
        row = [f"{'θ' if name == 'theta' else name}, {unit}"]
        row += [decimal(value, 3), at_least(lo, 3), at_most(hi, 3)]
        if name == "theta" and not answer.symmetry_order:
            row = [row[0], "any", "", ""]
        rows.append((*row, *([] if real is None else [decimal(factor * getattr(real, name), 3)])))
    names = ("", answer.object or "", "at least", "at most", *([] if real is None else ["truth"]))
    return table(names, rows, names[1:])


def _rivals(grips: Sequence[GripRecord], objects: Sequence[ObjectModel]) -> str:
    """Every state of the catalogue that is not left, with the grip that ruled it out, and by what."""
    judged = [grip for grip in grips if grip.verdict is not None]
    if not judged:
        return paragraph("No contact was interpreted.")
    last_seen = {item.name: grip.number for grip in judged for item in grip.hypotheses}
    left = {item.name for item in judged[-1].hypotheses}
    catalogue = Catalogue(objects)
    contacts = [contact for touch in judged[0].touches for contact in touch.evidence]
    record = ContactRecord([contacts])
    rows, explained = [], 0
    numbers = [grip.number for grip in judged]
    for state in catalogue.states:
        name = f"{state.object_name}, {state.state.name}"
        if name in left:
            continue
        if name in last_seen:
            by = numbers[min(numbers.index(last_seen[name]) + 1, len(numbers) - 1)]
            rows.append((name, f"grip {by}", "it agreed with the grips before"))
            continue
        why = "by its contacts"
        if explained < _MAX_RIVALS_EXPLAINED:
            explained += 1
            told = explain_object(catalogue, contacts, state.object_name, state.state.name)
            why = why_lines(told, record)[0].removeprefix(f"{name}: ").removeprefix("ruled out ")
        rows.append((name, f"grip {judged[0].number}", why))
    if not rows:
        return paragraph("There was no rival.")
    return table(("rival", "ruled out by", "how"), rows)


def _timing(grips: Sequence[GripRecord], summary: SessionOut) -> str:
    """A row for each grip: when it began, what each stage took, and all of it."""
    stages = list(dict.fromkeys(stage for grip in grips for stage, _ in grip.stages))
    rows = []
    for at, grip in enumerate(grips):
        later = grips[at + 1].stages if at + 1 < len(grips) else []
        end = later[0][1] if later else summary.duration
        begins = [begin for _, begin in grip.stages]
        took = dict.fromkeys(stages, 0.0)
        for (stage, begin), after in zip(grip.stages, [*begins[1:], end], strict=True):
            took[stage] += after - begin
        begin = begins[0] if begins else end
        times = (begin, *took.values(), end - begin)
        rows.append((str(grip.number), *(f"{time:.2f}" for time in times)))
    rows.append(("all", *[""] * (len(stages) + 1), f"{summary.duration:.2f}"))
    names = ("grip", "began, s", *(f"{stage}, s" for stage in stages), "together, s")
    return table(names, rows, names[1:])


def _devices(rig: RigFile, file: SessionFile) -> str:
    urls = {
        entry.what.port: str(entry.what.url) for entry in file.entries if isinstance(entry.what, PortOpened)
    }
    rows = [("bus", rig.bus.port, urls.get(rig.bus.port, "not opened"), f"{rig.bus.baudrate_bps} bit/s")]
    for finger in rig.fingers:
        servos = ", ".join(
            f"{joint}: {item.model}, ID {item.dxl_id}" for joint, item in finger.servos.items()
        )
        port = finger.array.port
        rows.append((finger.name, port, urls.get(port, "not opened"), servos))
    return table(("", "port", "opened as", "servos"), rows)


def _calibration(answer: IdentificationOut | None, summary: SessionOut) -> str:
    if not summary.calibration:
        return paragraph("None was used: the rig file's own bounds hold.")
    used = None if answer is None else answer.calibration
    if used is None:
        return paragraph("One was used; the run ended before it could be judged.")
    rows = [(name.replace("_", " "), str(value)) for name, value in used.model_dump(mode="json").items()]
    return table(("", ""), rows)


def _versions(file: SessionFile, summary: SessionOut) -> str:
    """Say what the run began with; whether devices were emulated, and the seed, as far as it counts."""
    known = {**file.header, "emulated": summary.emulated, "seed": summary.seed}
    left_out = ("format", "sum", *(name for name, value in known.items() if value is None))
    rows = [
        (name.replace("_", " "), _value_text(value)) for name, value in known.items() if name not in left_out
    ]
    return table(("", ""), rows)


def _value_text(value: object) -> str:
    return {True: "yes", False: "no"}.get(value, str(value)) if isinstance(value, bool) else str(value)


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read: {error}") from error
