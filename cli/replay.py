"""`palpate replay`: a recorded session run again, without devices, and compared byte by byte."""

import math
import re
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import typer

from palpate.config.replay_result import DifferenceOut, EndOut, ReplayOut
from palpate.config.results import to_json
from palpate.errors import InputError, counted
from palpate.recognizer import Catalogue
from palpate.rig.bench import place
from palpate.rig.emulated.calibrated_truth import placement_seen
from palpate.rig.session.inputs import calibrated_run, kept_inputs
from palpate.rig.session.log import LOG_NAME
from palpate.rig.session.log_reader import SessionFile, read_session
from palpate.rig.session.replay import Replayed, replay
from palpate.rig.session.run import IdentificationJob
from palpate.vocabulary import Strategy

__all__ = ["run_replay"]


def run_replay(session: Path, *, json: bool) -> int:
    """Replay the session in a folder; returns the exit code: 0 as recorded, 1 if something differs.

    Raises InputError for a folder without a session that can be replayed, and for a log that was changed
    after it was written although the replay met no difference.
    """
    folder = session.parent if session.name == LOG_NAME and session.is_file() else session
    file = read_session(folder)
    job = _job(file, folder)
    replayed = replay(file, job, _latency_s(file))
    if file.changed_line is not None:
        changed = f"{file.path}: line {file.changed_line}: is not as it was written: its check sum is wrong"
        if replayed.difference is None:
            raise InputError(f"{changed}; replaying it made no difference")
        typer.echo(changed, err=True)
    by, now = str(file.header.get("palpate")), version("palpate")
    if by != now:
        typer.echo(f"recorded by palpate {by}, replayed by {now}", err=True)
    out = _out(file, replayed, by, str(folder))
    typer.echo(to_json(out) if json else "\n".join(_lines(file, out)))
    return 0 if out.same else 1


def _job(file: SessionFile, folder: Path) -> IdentificationJob:
    seed, strategy = file.header.get("seed"), file.header.get("strategy")
    scene: Any = file.header.get("scene", False)
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise InputError(f'{file.path}: line 1: "seed" must be a whole number from 0')
    names = [item.value for item in Strategy]
    if strategy not in names:
        raise InputError(f'{file.path}: line 1: "strategy" must be one of {", ".join(names)}')
    if not isinstance(scene, bool):
        raise InputError(f'{file.path}: line 1: "scene" must be true or false')
    on_bench, objects, given = kept_inputs(folder, scene=scene, calibration=calibrated_run(file))
    placement = placement_seen(on_bench, place(on_bench.described, objects, given, seed), seed)
    models = Catalogue(objects.objects)
    started = None if on_bench.calibration is None else _started(file)
    return IdentificationJob(
        on_bench.rig, models, placement, Strategy(strategy), seed, on_bench.calibration, started
    )


def _started(file: SessionFile) -> datetime:
    """When the session began, from which its calibration's age was counted."""
    try:
        started = datetime.fromisoformat(str(file.header.get("started")))
    except ValueError:
        started = datetime.min
    if started.tzinfo is None:
        raise InputError(f'{file.path}: line 1: "started" must be a date and time in UTC')
    return started


def _latency_s(file: SessionFile) -> float:
    value = file.header.get("bus_latency_s")
    if not isinstance(value, int | float) or isinstance(value, bool) or not 0 <= value < math.inf:
        raise InputError(f'{file.path}: line 1: "bus_latency_s" must be a time in s, from 0')
    return float(value)


def _out(file: SessionFile, replayed: Replayed, by: str, folder: str) -> ReplayOut:
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


def _lines(file: SessionFile, out: ReplayOut) -> list[str]:
    """What a person is told."""
    done = (
        f"replayed {counted(out.events, 'event', 'events')}, {counted(out.sent_bytes, 'byte', 'bytes')} sent"
    )
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
