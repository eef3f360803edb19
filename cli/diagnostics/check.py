"""`palpate check`: is everything there, healthy and set up as the rig file says?

Moves nothing, unless it is asked to touch a disc and see whether the calibration still holds.
"""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import typer
from rich.console import Console

from palpate.calibration.agreement import contact_uncertainties
from palpate.cli.commissioning.confirm_motion import ask_to_move
from palpate.cli.commissioning.reference_placement import ConsoleTable
from palpate.cli.terminal import Doing, Terminal
from palpate.config import CalibrationFile
from palpate.config.check_result import CheckOut
from palpate.config.references_file import ReferencesFile, load_references, references_sha256
from palpate.config.results import to_json
from palpate.config.shipped import shipped_references
from palpate.errors import InputError
from palpate.rig.background import BackgroundCall
from palpate.rig.bench import emulated_table, outside, set_up
from palpate.rig.calibrated_rig import RigOnBench, load_calibrated
from palpate.rig.commissioning.calibration import build_references, slide_fingers
from palpate.rig.commissioning.calibration_hand import rig_connector
from palpate.rig.diagnostics.bus_selection import endpoint_of_rig
from palpate.rig.diagnostics.calibration_check import with_calibration, with_touch
from palpate.rig.diagnostics.retouch import Retouch, retouch
from palpate.rig.diagnostics.rig_check import check_rig
from palpate.views.check_table import show

__all__ = ["Touching", "run_check"]


@dataclass(frozen=True)
class Touching:
    """A disc is to be touched: the file that describes it, None for the standard one; `yes`: do not ask."""

    references: Path | None
    yes: bool


def run_check(
    *, rig: Path | None, json: bool, calibration: bool = True, touching: Touching | None = None, seed: int = 0
) -> int:
    """Check and show; returns the exit code: 3 if something is wrong, 0 with warnings alone.

    `touching`: None to move nothing. `seed`: of an emulated rig's devices.
    """
    on_bench = load_calibrated(rig, calibration=calibration)
    shapes = None if touching is None else _shapes(on_bench, touching)
    err = Terminal(stderr=True, soft_wrap=True)
    with Doing(err, "checking") as doing:
        out = check_rig(on_bench.rig, endpoint_of_rig(on_bench.described, seed), doing.now)
    out = with_calibration(out, on_bench, datetime.now(UTC))
    display = BackgroundCall("the display", err.print)
    if touching is not None and shapes is not None:
        out = _with_touch(out, on_bench, shapes, err, display, yes=touching.yes, seed=seed)
    if json:
        typer.echo(to_json(out))
    show(out, err if json else Terminal(soft_wrap=True))
    if display.late_failure is not None:
        raise display.late_failure
    return 0 if out.well else 3


def _shapes(on_bench: RigOnBench, touching: Touching) -> ReferencesFile:
    """What is to be touched; InputError if there is nothing to compare touches with."""
    slide_fingers(on_bench.described)
    if on_bench.calibration is None or contact_uncertainties(on_bench.calibration, at_rest=False) is None:
        raise InputError(
            "--touch compares touches with a calibration, and there is none that says where all fingers "
            f"stand: make it with `palpate calibrate --rig {on_bench.path}`"
        )
    return load_references(touching.references or shipped_references())


def _with_touch(
    out: CheckOut,
    on_bench: RigOnBench,
    shapes: ReferencesFile,
    console: Console,
    display: BackgroundCall,
    *,
    yes: bool,
    seed: int,
) -> CheckOut:
    """The check's result with that of touching the disc; nothing moves on a rig that is not well."""
    file = on_bench.calibration
    assert file is not None, "refused before"
    warnings = [*out.warnings, *_other_references(file, shapes)]
    if not out.well:
        warnings.append("nothing was touched: first put right what is wrong")
        return out.model_copy(update={"warnings": tuple(warnings)})
    if not yes:
        ask_to_move(console)
    found = _touched(on_bench, file, shapes, console, display, seed)
    return with_touch(out.model_copy(update={"warnings": tuple(warnings)}), found)


def _touched(
    on_bench: RigOnBench,
    file: CalibrationFile,
    shapes: ReferencesFile,
    console: Console,
    display: BackgroundCall,
    seed: int,
) -> Retouch:
    """Connect, touch the disc, disconnect."""
    promises = contact_uncertainties(file, at_rest=False)
    assert promises is not None, "refused before"
    bench = set_up(on_bench.described, None, seed)
    table = emulated_table(bench, seed) or ConsoleTable(console)
    disc, _ = build_references(shapes)
    with display as show_beside:
        connect = rig_connector(outside(bench), table, show_beside)
        with connect(on_bench.rig, moving=True) as there:
            return retouch(on_bench.rig, there.prober, disc, promises, lambda text: show_beside(f"  {text}"))


def _other_references(file: CalibrationFile, shapes: ReferencesFile) -> list[str]:
    """A warning if the calibration was made with other things than what is touched now."""
    if not file.references or references_sha256(shapes) in {item.sha256 for item in file.references}:
        return []
    return [
        "the calibration was made with other references: give theirs with --references, or make sure that "
        "the disc is as described"
    ]
