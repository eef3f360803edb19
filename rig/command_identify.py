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

from palpate.config import load_objects, load_rig, load_scene, shipped_objects, shipped_rig
from palpate.config.identification_result import AlternativeOut, IdentificationOut, IdentificationVerdict
from palpate.config.results import to_json
from palpate.recognizer import Catalogue, Grip, Recognition, Strategy
from palpate.rig.bench import connect, place, set_up
from palpate.rig.closing import Stage, Touch
from palpate.rig.convert import models_of
from palpate.rig.files import check_place, write_text
from palpate.rig.identify import Outcome, identify
from palpate.rig.report import contacts_json
from palpate.rig.report_run import identification_out, identification_picture
from palpate.rig.session import SessionLog, session_folder

__all__ = ["run_identify"]

_NAMES_SHOWN = 5
_ALTERNATIVES_SHOWN = 12


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
) -> int:
    """Run the bench to a verdict; returns the exit code (1 if it is not an answer).

    `strategy`: how grips are chosen, as `Strategy` names it.
    """
    begin = time.perf_counter()
    sources: list[Path | Traversable] = [rig or shipped_rig(), objects or shipped_objects()]
    rig_file, objects_file = load_rig(sources[0]), load_objects(sources[1])
    given_scene = None if scene is None else load_scene(scene)
    placement = place(rig_file, objects_file, given_scene, seed)
    if picture is not None:
        check_place(picture)
    catalogue = Catalogue(models_of(objects_file))
    bench = set_up(rig_file, placement, seed)
    name = _session_name(sources, scene, seed, strategy, emulated=rig_file.emulated)
    folder = session_folder(sessions, name)
    header = {"palpate": version("palpate"), "rig": rig_file.name, "seed": seed}
    header |= {"strategy": strategy, "started": _now()}
    console = Console(stderr=True, highlight=False)
    with SessionLog(folder, bench.clock, header) as log, Progress(console) as progress:
        with connect(bench, log.tap) as hand:
            hand.prepare()
            result = identify(hand, catalogue, [log, progress], strategy=Strategy(strategy), seed=seed)
            emulated = hand.emulated
        out = identification_out(
            result,
            placement,
            emulated=emulated,
            rig_seconds=bench.clock.now(),
            wall_seconds=time.perf_counter() - begin,
            session=str(folder),
            strategy=Strategy(strategy),
        )
        log.event("result", result=out.model_dump(mode="json"))
    drawn = identification_picture(result, placement, rig_file, _facts(out))
    write_text(folder / "picture.svg", drawn)
    write_text(folder / "result.json", to_json(out, indent=2) + "\n")
    felt = contacts_json([[touch.contact for touch in grip] for grip in result.grips])
    write_text(folder / "contacts.json", jsonlib.dumps(felt, indent=1) + "\n")
    if picture is not None:
        write_text(picture, drawn)
    if json:
        typer.echo(to_json(out))
    else:
        _print(out, picture or folder / "picture.svg")
    resolved = result.outcome in (Outcome.IDENTIFIED, Outcome.INDISTINGUISHABLE)
    return 0 if resolved else 1


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

    def stage(self, grip: int, stage: Stage) -> None:
        """Fingers began something."""
        if self._status is not None:
            self._status.update(f"grip {grip}: {stage.value}")

    def touches(self, grip: int, touches: Sequence[Touch]) -> None:
        """A grip was carried out."""
        felt = ", ".join(
            f"{touch.contact.name} {'touched' if touch.contact.touched else 'missed'}" for touch in touches
        )
        self._console.print(f"grip {grip}: {felt}")

    def recognised(self, grip: int, recognition: Recognition) -> None:
        """All contacts so far were understood."""
        del grip
        names = [item.state.object_name for item in recognition.hypotheses]
        distinct = list(dict.fromkeys(names))
        shown = ", ".join(distinct[:_NAMES_SHOWN])
        more = f" and {len(distinct) - _NAMES_SHOWN} more" if len(distinct) > _NAMES_SHOWN else ""
        count = "1 hypothesis" if len(names) == 1 else f"{len(names)} hypotheses"
        self._console.print(f"        {count}{': ' if names else ''}{shown}{more}")

    def moved(self, grip: int) -> None:
        """The part seems to have been moved."""
        self._console.print(
            f"        grip {grip} contradicts the earlier ones: the part may have been moved; "
            "earlier grips are dropped"
        )

    def planned(self, grip: int, plan: Grip) -> None:
        """The next grip was chosen."""
        if self._status is not None:
            self._status.update(f"grip {grip}: planned{', decisive' if plan.decisive else ''}")


def _session_name(
    sources: Sequence[Path | Traversable],
    scene: Path | None,
    seed: int,
    strategy: str,
    *,
    emulated: bool,
) -> str:
    """After everything that decides an emulated session, so that it is the same again; else the time."""
    if not emulated:
        return datetime.now(UTC).strftime("identify-%Y%m%d-%H%M%S")
    content = hashlib.sha256(version("palpate").encode())
    for source in [*sources, *([] if scene is None else [scene])]:
        content.update(source.read_bytes())
    content.update(strategy.encode())
    return f"identify-seed-{seed}-{content.hexdigest()[:8]}"


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


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


def _print(out: IdentificationOut, picture: Path) -> None:
    """The answer for a person."""
    for line in _verdict_lines(out):
        typer.echo(line)
    if out.configuration is not None and out.bounds is not None:
        at, bounds = out.configuration, out.bounds
        typer.echo(f"  x  {at.x:9.3f} mm   in [{bounds.x[0]:.3f}, {bounds.x[1]:.3f}]")
        typer.echo(f"  y  {at.y:9.3f} mm   in [{bounds.y[0]:.3f}, {bounds.y[1]:.3f}]")
        lo, hi = (math.degrees(value) for value in bounds.theta)
        typer.echo(f"  θ  {math.degrees(at.theta):9.3f} °    in [{lo:.3f}, {hi:.3f}]")
        if out.symmetry_order > 1:
            typer.echo(f"  ({out.symmetry_order}-fold symmetric: θ modulo {360 / out.symmetry_order:g}°)")
    for other in out.alternatives[:_ALTERNATIVES_SHOWN]:
        typer.echo(f"  {_alternative_line(other)}")
    if len(out.alternatives) > _ALTERNATIVES_SHOWN:
        typer.echo(f"  or one of {len(out.alternatives) - _ALTERNATIVES_SHOWN} more; --json lists them all")
    if out.verdict == IdentificationVerdict.IDENTIFIED and out.foretold:
        typer.echo(f"  {_counted(out.foretold, 'touch', 'touches')} came out as this foretold")
    if out.truth is not None:
        typer.echo(_truth_line(out))
    typer.echo(
        f"{_counted(out.grips, 'grip', 'grips')}, {_counted(out.touches, 'touch', 'touches')}, "
        f"{out.rig_seconds:.1f} s on the {'emulated ' if out.emulated else ''}rig, "
        f"{out.wall_seconds:.1f} s here"
    )
    typer.echo(f"picture {picture}, session {out.session}")


def _verdict_lines(out: IdentificationOut) -> list[str]:
    """What it is, or why that is not said."""
    if out.object is None and out.verdict == IdentificationVerdict.UNKNOWN:
        lines = [f"{out.verdict}: no object of the catalogue agrees with what was felt"]
        if out.moved_before:
            lines.append(f"  or it was moved again: it seems to have been moved before grip {_last(out)}")
        return lines
    if out.object is None:
        return [f"{out.verdict}: too little was touched to tell anything"]
    name = f"{out.object}, {out.state}"
    if out.verdict == IdentificationVerdict.UNRESOLVED:
        left = "is all that agrees with what was felt" if not out.alternatives else "is still possible"
        lines = [f"{out.verdict}: {name} {left}"]
    elif out.verdict == IdentificationVerdict.INDISTINGUISHABLE:
        lines = [f"{out.verdict}: {name}, or something that no touch within reach tells from it"]
    else:
        lines = [f"{out.verdict}: {name}"]
    if out.moved_before:
        lines.append(f"  moved before grip {_last(out)}; touches since then count")
    return lines


def _last(out: IdentificationOut) -> int:
    return out.moved_before[-1]


def _alternative_line(other: AlternativeOut) -> str:
    at = other.configuration
    where = f"x {at.x:.2f} mm, y {at.y:.2f} mm, θ {math.degrees(at.theta):.2f}°"
    if other.turned is None or other.moved is None:
        return f"or {other.object}, {other.state} at {where}"
    return f"or turned by {math.degrees(other.turned):.1f}° and moved by {other.moved:.1f} mm: {where}"


def _counted(count: int, one: str, many: str) -> str:
    return f"{count} {one if count == 1 else many}"


def _truth_line(out: IdentificationOut) -> str:
    truth = out.truth
    assert truth is not None, "only called with a truth"
    where = truth.configuration
    line = (
        f"emulator's truth: {truth.object}, {truth.state} at x {where.x:.3f} mm, y {where.y:.3f} mm, "
        f"θ {math.degrees(where.theta):.3f}°"
    )
    if not truth.named or truth.position_error_mm is None or truth.orientation_error_rad is None:
        return f"{line}; not among the answers"
    turned = math.degrees(truth.orientation_error_rad)
    return (
        f"{line}; off by {truth.position_error_mm:.3f} mm and {turned:.3f}°, "
        f"{'inside' if truth.inside_bounds else 'OUTSIDE'} the bounds"
    )
