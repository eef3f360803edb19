"""The result of a replay, as its JSON and in words."""

import re

from palpate.base.errors import quantity
from palpate.config.session_results import DifferenceOut, EndOut, ReplayOut
from palpate.rig.session.log_reader import SessionFile
from palpate.rig.session.replay import Replayed


def replay_out(file: SessionFile, replayed: Replayed, by: str, folder: str) -> ReplayOut:
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
    )


def _difference(text: str) -> DifferenceOut:
    match = re.match(r"line ([0-9]+), ", text)
    return DifferenceOut(line=0 if match is None else int(match[1]), message=text)


def replay_lines(file: SessionFile, out: ReplayOut) -> list[str]:
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
        named = f": {out.object}, {out.state}" if out.object is not None else ""
        return f"{out.verdict}{named}"
    if out.end is None:
        return "no answer so far"
    return f"ended by {out.end.how}: {out.end.message}" if out.end.message else f"ended by {out.end.how}"
