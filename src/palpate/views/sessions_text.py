"""Recorded sessions on the terminal: a table of several, full information on one, and its replay."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

from palpate.base.errors import quantity
from palpate.base.vocabulary import SessionKind
from palpate.config.session_results import (
    DifferenceOut,
    EndOut,
    NamedPartOut,
    ReplayOut,
    SessionOut,
    UnreadableOut,
)
from palpate.views.tables import folding_column, table

if TYPE_CHECKING:  # a list of sessions needs nothing of the recogniser
    from palpate.rig.session.log_reader import SessionFile
    from palpate.rig.session.run import Replayed

_WORD = re.compile("([A-Z][a-z]+)")


def show_sessions(
    sessions: Sequence[SessionOut], unreadable: Sequence[UnreadableOut], console: Console
) -> None:
    """The table of sessions, what they take, and what cannot be read."""
    rows = table("started (UTC)", "rig", "session", folding_column("answer"), "size", numbers={"size"})
    for item in sessions:
        rows.add_row(
            (item.began or "?")[:16].replace("T", " "),
            escape(item.rig or "?"),
            escape(Path(item.path).name),
            escape(answer_words(item)),
            size_words(item.bytes),
        )
    if sessions:
        console.print(rows)
    total = size_words(sum(item.bytes for item in sessions))
    console.print(f"{quantity(len(sessions), 'session', 'sessions')}, {total}", highlight=False)
    for bad in unreadable:
        console.print(f"! {Path(bad.path).name}: {bad.why}", highlight=False, markup=False)


def info_lines(item: SessionOut) -> list[str]:
    """One session in words."""
    rows = [
        ("session", f"{item.path}, {size_words(item.bytes)}"),
        ("started", f"{instant_words(item.began) or 'not recorded'}, palpate {item.palpate or '?'}"),
        ("rig", f"{_rig_words(item)}{_seed_words(item)}{_calibration_words(item)}"),
        ("ran", f"{item.duration:.1f} s, {_counts(item)}"),
        ("answer", answer_words(item)),
        ("ended", _end_words(item)),
    ]
    if item.ended is not None and item.ended.message and item.ended.message != _end_words(item):
        rows.append(("", item.ended.message))
    return [f"{name:<8} {words}" for name, words in rows]


def _counts(item: SessionOut) -> str:
    return f"{quantity(item.grips, 'grip', 'grips')}, {quantity(item.touches, 'touch', 'touches')}"


def instant_words(began: str | None) -> str:
    """Say when a session began, as people write it; "" if that was not recorded."""
    return f"{began[:19].replace('T', ' ')} UTC" if began else ""


def size_words(count: int) -> str:
    """A number of bytes as people say it."""
    return f"{count / 1e6:.1f} MB" if count >= 100_000 else f"{count / 1e3:.1f} kB"


def _rig_words(item: SessionOut) -> str:
    kind = {True: " (emulated)", False: "", None: ""}[item.emulated]
    return f"{item.rig or '?'}{kind}"


def _seed_words(item: SessionOut) -> str:
    return "" if item.seed is None else f", seed {item.seed}"


def _calibration_words(item: SessionOut) -> str:
    return ", calibrated" if item.calibration else ", without a calibration"


def answer_words(item: SessionOut) -> str:
    """Say what a session found, or how it ended."""
    if item.verdict is None and item.command == SessionKind.CONNECT:
        end = _end_words(item)
        return "grips of a program" if end == "done" else f"grips of a program ({end})"
    if item.verdict is None:
        end = _end_words(item)
        return "none" if end == "done" else f"none ({end})"
    return _named_words(item)


def _named_words(item: SessionOut | ReplayOut) -> str:
    """A verdict with what it names: an object and its state, or those of each part."""
    parts = [_part_words(part, item.verdict) for part in item.parts]
    parts = parts or ([f"{item.object}, {item.state}"] if item.object else [])
    return ": ".join(filter(None, (item.verdict, "; ".join(parts))))


def _part_words(part: NamedPartOut, verdict: str | None) -> str:
    name = f"{part.object}, {part.state}" if part.object else "a part"
    return name if part.verdict == verdict else f"{name} ({part.verdict})"


def _end_words(item: SessionOut) -> str:
    if item.ended is None:
        return "running" if item.writing else "killed"
    return _WORD.sub(r" \1", item.ended.how).strip().lower()  # "NotAnswering": not answering


def replay_out(file: "SessionFile", replayed: "Replayed", by: str, folder: str) -> ReplayOut:
    """The published result; `by`: the version of palpate that recorded the session."""
    answer = None if replayed.run is None else replayed.run.out(wall_seconds=0.0, session=None)
    return ReplayOut(
        same=replayed.difference is None,
        events=replayed.lines,
        sent_bytes=replayed.sent_bytes,
        received_bytes=replayed.received_bytes,
        end=None if file.end is None else EndOut(how=file.end["how"], message=file.end.get("message")),
        verdict=answer and answer.verdict.value,
        object=answer and answer.object,
        state=answer and answer.state,
        difference=None if replayed.difference is None else _difference(replayed.difference),
        recorded_by=by,
        session=folder,
        parts=() if answer is None else tuple(NamedPartOut.of(part) for part in answer.parts),
    )


def _difference(text: str) -> DifferenceOut:
    match = re.match(r"line ([0-9]+), ", text)
    return DifferenceOut(line=0 if match is None else int(match[1]), message=text)


def replay_lines(file: "SessionFile", out: ReplayOut) -> list[str]:
    """The report for a person."""
    events, sent = quantity(out.events, "event", "events"), quantity(out.sent_bytes, "byte", "bytes")
    done = f"replayed {events}, {sent} sent"
    if out.difference is not None:
        return [f"{done}, then it differs: {file.path}: {out.difference.message}"]
    lines = [f"{done}, all as recorded; {_ending(out)}"]
    if out.end is None:
        last = file.entries[-1].line if file.entries else 1
        lines.append(f"the log was cut off after line {last}: it has no end")
    return lines


def _ending(out: ReplayOut) -> str:
    if out.verdict is not None:
        return _named_words(out)
    if out.end is None:
        return "no answer so far"
    if out.end.how == "done":
        return "ended in order"
    return f"ended by {out.end.how}: {out.end.message}" if out.end.message else f"ended by {out.end.how}"
