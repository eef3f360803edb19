"""`palpate identify`: the main job, from a rig file to a verdict, a session log and a picture."""

import hashlib
import json as jsonlib
import math
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.resources.abc import Traversable
from pathlib import Path

import typer
from rich.console import Console
from rich.status import Status

from palpate.cli.terminal import Terminal, print_notices
from palpate.config import load_objects, load_scene, shipped_objects
from palpate.config.identification_result import IdentificationOut
from palpate.config.loading import source_name
from palpate.config.results import to_json
from palpate.errors import counted
from palpate.files.writing import check_place, write_text
from palpate.recognizer import Catalogue, Recognition
from palpate.rig.bench import outside, place, set_up
from palpate.rig.bus_latency import bus_latency_s
from palpate.rig.calibrated_rig import load_calibrated
from palpate.rig.catalogue.reachability_text import finding_lines, untouched_lines
from palpate.rig.emulated.calibrated_truth import placement_seen
from palpate.rig.emulated.scene_reachability import scene_lines
from palpate.rig.identification.observers import (
    Event,
    MoveEvent,
    PlanEvent,
    RecognitionEvent,
    StageEvent,
    TouchEvent,
)
from palpate.rig.identification.preconditions import check_known_well
from palpate.rig.session.inputs import keep_inputs
from palpate.rig.session.log import SessionLog, session_folder
from palpate.rig.session.run import IdentificationJob, IdentificationRun, run_identification
from palpate.rig.session.signals import HeldInterrupts
from palpate.views.answer import answer_lines
from palpate.views.recognition import contacts_json
from palpate.views.run import identification_picture
from palpate.vocabulary import IdentificationVerdict, Strategy

__all__ = ["run_identify"]

_NAMES_SHOWN = 5


def run_identify(
    *,
    rig: Path | None,
    objects: Path | None,
    scene: Path | None,
    seed: int,
    json: bool,
    picture: Path | None,
    sessions: Path,
    strategy: str = Strategy.PLANNED.value,
    calibration: bool = True,
) -> int:
    """Run the bench to a verdict; returns the exit code (1 if it is not an answer).

    `strategy`: how grips are chosen, as `Strategy` names it. `calibration`: False to do without the one
    beside the rig file.
    """
    begin = time.perf_counter()
    on_bench = load_calibrated(rig, calibration=calibration)
    rig_file, objects_source = on_bench.rig, objects or shipped_objects()
    check_known_well(rig_file, str(on_bench.path))
    objects_file = load_objects(objects_source)
    given_scene = None if scene is None else load_scene(scene)
    lying = place(on_bench.described, objects_file, given_scene, seed)
    notices = finding_lines(rig_file, objects_file.objects, source_name(objects_source))
    if lying is not None and given_scene is not None:
        notices += scene_lines(on_bench.described, lying)
    print_notices(notices)
    if picture is not None:
        check_place(picture)
    bench = set_up(on_bench.described, lying, seed)
    placement = placement_seen(on_bench, lying, seed, bench.emulated)
    catalogue = Catalogue(objects_file.objects)
    started = datetime.now(UTC).replace(microsecond=0)
    job = IdentificationJob(
        rig_file, catalogue, placement, Strategy(strategy), seed, on_bench.calibration, started
    )
    sources = [on_bench.path, objects_source, on_bench.calibration_path, scene]
    name = _session_name(sources, seed, strategy, emulated=rig_file.emulated)
    folder = session_folder(sessions, name)
    header = {"palpate": version("palpate"), "rig": rig_file.name, "seed": seed}
    header |= {"strategy": strategy, "scene": scene is not None}
    header |= {"calibration": on_bench.calibration is not None, "started": started.isoformat()}
    latency_s = bus_latency_s(rig_file)
    header |= {"bus_latency_s": latency_s}
    console = Terminal(stderr=True, highlight=False, markup=False)
    out: IdentificationOut | None = None
    try:
        with SessionLog(folder, bench.clock, header) as log, Progress(console) as progress:
            keep_inputs(folder, on_bench, objects_source, scene)
            with HeldInterrupts() as held:
                recorded = outside(bench, log, latency_s, held.check)
                run = run_identification(job, recorded, log, [progress], progress.notice)
            out = run.out(wall_seconds=time.perf_counter() - begin, session=str(folder))
            log.event("result", result=out.model_dump(mode="json"))
        _write_results(run, out, folder, picture)
    finally:
        if out is not None:  # an answer that could not be written down is still an answer
            if json:
                typer.echo(to_json(out))
            else:
                advice = untouched_lines(rig_file, objects_file.objects)
                _print(out, advice, picture or folder / "picture.svg")
    if run.late_failure is not None:
        raise run.late_failure
    resolved = run.result.outcome in (
        IdentificationVerdict.IDENTIFIED,
        IdentificationVerdict.INDISTINGUISHABLE,
    )
    return 0 if resolved else 1


def _write_results(
    run: IdentificationRun, out: IdentificationOut, folder: Path, picture: Path | None
) -> None:
    """Write picture, answer and contacts into the session's folder, and the picture where it is wanted."""
    drawn = identification_picture(run.result, run.job.placement, run.job.rig, _facts(out))
    if picture is not None:
        write_text(picture, drawn)
    write_text(folder / "picture.svg", drawn)
    write_text(folder / "result.json", to_json(out, indent=2) + "\n")
    felt = contacts_json([[touch.contact for touch in grip] for grip in run.result.grips])
    write_text(folder / "contacts.json", jsonlib.dumps(felt, indent=1) + "\n")


class Progress:
    """Shows on stderr what the bench is doing: a line for each grip, and a moving line on a terminal."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._status: Status | None = None

    def __enter__(self) -> "Progress":
        if self._console.is_terminal:
            self._status = self._console.status("connecting")
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is not None:
            self._status.stop()

    def notice(self, text: str) -> None:
        """The operator should know or do something now."""
        self._console.print(text)

    def __call__(self, event: Event) -> None:
        """Show an event."""
        match event:
            case StageEvent(grip, stage):
                self._now(f"grip {grip}: {stage.value}")
            case PlanEvent(grip, plan):
                self._now(f"grip {grip}: planned{', decisive' if plan.decisive else ''}")
            case TouchEvent(grip, touches):
                contacts = [touch.contact for touch in touches]
                each = (f"{item.name} {'touched' if item.touched else 'missed'}" for item in contacts)
                self._console.print(f"grip {grip}: {', '.join(each)}")
            case RecognitionEvent():
                self._console.print(f"        {_hypotheses(event.recognition)}")
            case MoveEvent():
                self._console.print(
                    "        contradicts earlier grips: the part may have moved, they are dropped"
                )

    def _now(self, text: str) -> None:
        if self._status is not None:
            self._status.update(text)


def _hypotheses(recognition: Recognition) -> str:
    """How many hypotheses are left, and the first of their objects' names."""
    names = [item.state.object_name for item in recognition.hypotheses]
    distinct = list(dict.fromkeys(names))
    shown = ", ".join(distinct[:_NAMES_SHOWN])
    more = f" and {len(distinct) - _NAMES_SHOWN} more" if len(distinct) > _NAMES_SHOWN else ""
    return f"{counted(len(names), 'hypothesis', 'hypotheses')}{': ' if names else ''}{shown}{more}"


def _session_name(
    sources: Sequence[Path | Traversable | None],
    seed: int,
    strategy: str,
    *,
    emulated: bool,
) -> str:
    """After everything that decides an emulated session, so that it is the same again; else the time."""
    if not emulated:
        return datetime.now(UTC).strftime("identify-%Y%m%d-%H%M%S")
    content = hashlib.sha256(version("palpate").encode())
    for source in sources:
        content.update(b"" if source is None else source.read_bytes())
    content.update(strategy.encode())
    return f"identify-seed-{seed}-{content.hexdigest()[:8]}"


def _facts(out: IdentificationOut) -> list[tuple[str, str]]:
    """Rows for the picture's panel; nothing that differs between two runs of one seed."""
    rows = [
        ("grips", str(out.grips)),
        ("touches", str(out.touches)),
        ("came out as foretold", str(out.foretold)),
        ("strategy", out.strategy.value),
        ("rig time", f"{out.rig_seconds:.1f} s"),
        ("devices", "emulated" if out.emulated else "hardware"),
    ]
    if out.symmetry_order > 1:
        rows.append(("symmetry", f"{out.symmetry_order}-fold: θ modulo {360 / out.symmetry_order:g}°"))
    if out.truth is not None and out.truth.named:
        off, turned = out.truth.position_error_mm or 0.0, math.degrees(out.truth.orientation_error_rad or 0.0)
        rows.append(("off the truth", f"{off:.2f} mm, {turned:.2f}°"))
    return rows


def _print(out: IdentificationOut, advice: Sequence[str], picture: Path) -> None:
    """The answer for a person."""
    for line in answer_lines(out, advice):
        typer.echo(line)
    typer.echo(
        f"{counted(out.grips, 'grip', 'grips')}, {counted(out.touches, 'touch', 'touches')}, "
        f"{out.rig_seconds:.1f} s on the {'emulated ' if out.emulated else ''}rig, "
        f"{out.wall_seconds:.1f} s here"
    )
    typer.echo(f"picture {picture}, session {out.session}")
