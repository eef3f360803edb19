"""Commands that measure a rig: `palpate calibrate` and `palpate home`. Fingers move."""

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from palpate.cli.terminal import (
    VIEW_PORT,
    JsonOption,
    NoCalibrationOption,
    ViewOption,
    ViewPortOption,
    note_on_interruption,
)


class _Steps(Enum):
    """Steps that `calibrate` can measure."""

    ALL = "all"
    TACTILE = "tactile"
    ACTUATORS = "actuators"
    FINGERS = "fingers"
    STAGE = "stage"


@note_on_interruption("what was done is kept; the same command goes on from there")
def calibrate(
    rig: Annotated[Path, typer.Option("--rig", help="Rig file (TOML).", show_default=False)],
    what: Annotated[
        _Steps, typer.Argument(help="What to measure; what is not measured stays as it was.")
    ] = _Steps.ALL,
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

    from palpate.base.file_io import check_places
    from palpate.cli.calibration_dialogue import (
        CalibrationProgress,
        ConsoleTable,
        announce,
        calibrate_out,
        show_calibration,
    )
    from palpate.cli.run_display import view_starter
    from palpate.cli.terminal import Terminal, ask_to_move, check_can_ask_to_move
    from palpate.config.fields import to_json
    from palpate.jobs.calibration import CalibrationPaths, check_references
    from palpate.jobs.files import load_references
    from palpate.jobs.rig import open_rig
    from palpate.rig.commissioning.calibration_run import STEPS, steps_of

    begin = time.perf_counter()
    opened, shapes = open_rig(rig, seed=seed, calibration=False), load_references(references)
    steps = steps_of(opened.file, STEPS if what is _Steps.ALL else (what.value,))
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
    with CalibrationProgress(console, asks=not opened.emulated) as progress:
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
    show_calibration(out, console if json else Terminal(highlight=False, soft_wrap=True))
    if answer.failure is not None:
        raise answer.failure
    return 0


@note_on_interruption("torque is off")
def home(
    rig: Annotated[Path, typer.Option("--rig", help="Rig file (TOML).", show_default=False)],
    yes: Annotated[bool, typer.Option("--yes", help="Fingers may move: do not ask.")] = False,
    no_calibration: NoCalibrationOption = False,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of an emulated rig's devices.")] = 0,
    json: JsonOption = False,
) -> int:
    """Find the turn that each slide stands in, after its servo was without power. Fingers move.

    One after the other, slides go back until they meet their back stop (stops_mm in the rig file). Runs
    home slides whose turn is unknown by themselves; this command homes all of them.
    """
    from palpate.cli.terminal import Terminal, ask_to_move
    from palpate.config.commissioning_results import HomedSlideOut, HomeOut
    from palpate.config.fields import to_json
    from palpate.jobs.rig import open_rig

    opened = open_rig(rig, seed=seed, calibration=not no_calibration)
    opened.check_homable()
    err = Terminal(stderr=True, highlight=False, soft_wrap=True)
    if not yes:
        ask_to_move(err, "Slides go back to their stops, one after the other. Are hands away?")
    found = opened.home(notice=err.print)
    if json:
        slides = tuple(HomedSlideOut(**vars(slide)) for slide in found)
        typer.echo(to_json(HomeOut(slides=slides)))
    out = err if json else Terminal(highlight=False, soft_wrap=True)
    for slide in found:
        out.print(
            f"{slide.finger}: slide (servo {slide.dxl_id}) is homed; its count is {_turns_words(slide.turns)}"
        )
    return 0


def _turns_words(turns: int) -> str:
    if turns == 0:
        return "that of its first turn"
    plural = "" if abs(turns) == 1 else "s"
    return f"{abs(turns)} turn{plural} {'ahead' if turns > 0 else 'behind'}"
