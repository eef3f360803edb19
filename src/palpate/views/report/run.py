"""Report of a run: verdict and bounds, each grip, why each rival fell, timing, devices, settings."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel
from palpate.config import RigFile
from palpate.config.identification_result import IdentificationOut
from palpate.config.sessions_result import SessionOut
from palpate.drivers.transport.recording import PortOpened
from palpate.recognizer import Catalogue
from palpate.recognizer.explanation import explain_object
from palpate.rig.session.log_reader import SessionFile
from palpate.rig.session.run_record import GripRecord, contacts_in, grip_records
from palpate.rig.session.samples import SessionSamples
from palpate.views.answer import answer_lines
from palpate.views.explanation import ContactRecord, why_lines
from palpate.views.report.grips import grip_sections, name_of
from palpate.views.report.page import heading, lines, page, paragraph, picture, section, table
from palpate.views.sessions_text import info_lines, instant_words

__all__ = ["run_report"]

_EXPLAINED = 40  # rivals whose elimination is explained; more would take minutes


def run_report(samples: SessionSamples, summary: SessionOut, folder: Path) -> str:
    """The page. A run that was cut off is reported as far as its log goes."""
    file, grips = samples.file, grip_records(samples.file)
    truths = file.told("truth")
    truth = truths[0] if truths else None
    answer = _answer(file)
    title = f"{answer.verdict.value.capitalize()}: {answer.object or 'no object'}" if answer else "No answer"
    parts = [
        heading(
            f"{title} – rig {summary.rig or '?'}",
            f"{Path(summary.path).name}, {instant_words(summary.began)}",
        ),
        section("Answer", *_answer_parts(answer, summary, folder)),
        *grip_sections(grips, samples.rig, samples.objects, truth),
        section("Why each rival fell", _rivals(grips, samples.objects)),
        section("Timing", _timing(grips, summary)),
        section("Devices", _devices(samples.rig, file)),
        section("Calibration", _calibration(answer, summary)),
        section("Versions", _versions(file, summary)),
        section("Rig file", lines(_text(folder / "rig.toml")), kind="settings"),
    ]
    return page(title, parts)


def _answer(file: SessionFile) -> IdentificationOut | None:
    results = file.told("result")
    return IdentificationOut.model_validate(results[-1]["result"]) if results else None


def _answer_parts(answer: IdentificationOut | None, summary: SessionOut, folder: Path) -> Iterator[str]:
    if answer is None:
        yield paragraph("The run ended before there was an answer.")
        yield lines("\n".join(info_lines(summary)))
        return
    yield lines("\n".join(answer_lines(answer)))
    drawn = folder / "picture.svg"
    if drawn.is_file():
        yield picture(_text(drawn))


def _rivals(grips: Sequence[GripRecord], objects: Sequence[ObjectModel]) -> str:
    """Every state of the catalogue that is not left, with the grip that ruled it out, and by what."""
    judged = [grip for grip in grips if grip.verdict is not None]
    if not judged:
        return paragraph("No contact was interpreted.")
    last_seen = {name_of(item): grip.number for grip in judged for item in grip.hypotheses}
    left = {name_of(item) for item in judged[-1].hypotheses}
    catalogue = Catalogue(objects)
    contacts = [contact for touch in judged[0].touches for contact in contacts_in(touch)]
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
        if explained < _EXPLAINED:
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
    """What the run began with; whether devices were emulated, and the seed, as far as it counts."""
    known = {**file.header, "emulated": summary.emulated, "seed": summary.seed}
    left_out = ("format", "sum", *(name for name, value in known.items() if value is None))
    rows = [(name.replace("_", " "), _shown(value)) for name, value in known.items() if name not in left_out]
    return table(("", ""), rows)


def _shown(value: object) -> str:
    return {True: "yes", False: "no"}.get(value, str(value)) if isinstance(value, bool) else str(value)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read: {error}") from error


_Values = Mapping[str, Any]
