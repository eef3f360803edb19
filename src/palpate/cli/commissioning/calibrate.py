"""`palpate calibrate`: measure a rig, write what was found beside the rig file, and a report."""

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.interruption import if_interrupted
from palpate.cli.options import VIEW_PORT, JsonOption, ViewOption, ViewPortOption

__all__ = ["calibrate"]


class _What(Enum):
    """What `calibrate` measures."""

    ALL = "all"
    TACTILE = "tactile"
    ACTUATORS = "actuators"
    FINGERS = "fingers"
    STAGE = "stage"


@if_interrupted("what was done is kept; the same command goes on from there")
def calibrate(
    rig: Annotated[Path, typer.Option("--rig", help="Rig file (TOML).", show_default=False)],
    what: Annotated[
        _What, typer.Argument(help="What to measure; what is not measured stays as it was.")
    ] = _What.ALL,
    references: Annotated[
        Path | None,
        typer.Option("--references", help="Disc and plate (TOML); without it, 50 mm and 80 mm square."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of an emulated rig's devices.")] = 0,
    yes: Annotated[bool, typer.Option("--yes", help="Fingers may move: do not ask.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done, and end.")] = False,
    restart: Annotated[
        bool, typer.Option("--restart", help="Forget a calibration that was begun before.")
    ] = False,
    view: ViewOption = False,
    view_port: ViewPortOption = VIEW_PORT,
    json: JsonOption = False,
) -> int:
    """Measure a rig and write its calibration beside the rig file. Fingers move.

    One that was interrupted is taken up where it ended.
    """
    import time

    from palpate.base.files.writing import check_places
    from palpate.cli.commissioning.calibration_text import Progress, announce, calibrate_out, show
    from palpate.cli.commissioning.confirm_motion import ask_to_move, check_can_ask_to_move
    from palpate.cli.commissioning.reference_placement import ConsoleTable
    from palpate.cli.terminal import Terminal
    from palpate.cli.view_process import view_starter
    from palpate.config.results import to_json
    from palpate.jobs.calibration import CalibrationPaths, check_references
    from palpate.jobs.files import load_references
    from palpate.jobs.rig import open_rig
    from palpate.rig.commissioning.calibration import STEPS, steps_of

    begin = time.perf_counter()
    opened, shapes = open_rig(rig, seed=seed, calibration=False), load_references(references)
    steps = steps_of(opened.file, STEPS if what is _What.ALL else (what.value,))
    check_references(opened.file, shapes)
    check_places(
        {f"the calibration's {place.suffix} file": place for place in CalibrationPaths.beside(rig).all},
        {"--references": references},
    )
    if not (dry_run or yes):
        check_can_ask_to_move()
    console = Terminal(stderr=True, highlight=False, soft_wrap=True)
    announce(console, opened.file, shapes, steps, CalibrationPaths.beside(rig))
    if dry_run:
        return 0
    if not yes:
        ask_to_move(console)
    with Progress(console, asks=not opened.emulated) as progress:
        answer = opened.calibrate(
            steps,
            references=shapes,
            table=None if opened.emulated else ConsoleTable(console),
            restart=restart,
            progress=progress.tell,
            on_session=view_starter(view_port) if view else None,
        )
    out = calibrate_out(answer, opened.described, steps, time.perf_counter() - begin)
    if json:
        typer.echo(to_json(out))
    show(out, console if json else Terminal(highlight=False, soft_wrap=True))
    if answer.failure is not None:
        raise answer.failure
    return 0
