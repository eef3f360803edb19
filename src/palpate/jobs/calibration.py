"""Calibration and homing of a rig from Python: measures, and writes the result beside the rig file."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Self

from palpate.base.errors import InputError, PalpateError
from palpate.base.file_io import check_place, write_text
from palpate.config import (
    CalibrationFile,
    RigFile,
    RigOnBench,
    calibration_path,
    calibration_toml,
    check_calibration,
    load_calibration,
)
from palpate.config.calibration_file import ReferencesFile
from palpate.config.wiring_record import ConfirmedWiring
from palpate.config.writers import keep_confirmed
from palpate.jobs.files import PathLike, load_references
from palpate.jobs.monitor import view_log
from palpate.rig.bench import connect, emulated_table, environment, set_up
from palpate.rig.commissioning.calibration_run import (
    CalibrationJob,
    RunRecordFile,
    build_references,
    calibrate,
    rig_connector,
)
from palpate.rig.commissioning.hand_prober import TableOperator
from palpate.rig.mechanisms import lowest_links, mechanism_of
from palpate.rig.motion.homing import HomingPolicy
from palpate.rig.workers import BackgroundCall
from palpate.views.report.calibration import write_report

SHIPPED_RIG = "the shipped rig cannot be calibrated: copy its rig file and open that one"

_COVERAGE = 0.999


@dataclass(frozen=True)
class CalibrationPaths:
    """Files beside the rig file."""

    calibration: Path
    record: Path
    report: Path

    @classmethod
    def beside(cls, rig: Path) -> Self:
        """Return the paths beside a rig file."""
        file = calibration_path(rig)
        return cls(file, file.with_suffix(".run.json"), file.with_suffix(".html"))

    @property
    def all(self) -> tuple[Path, Path, Path]:
        """Each of them."""
        return self.calibration, self.record, self.report


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationAnswer:
    """Result of a calibration, the files it was written to, and the time (s) it took on the rig's clock.

    `failure`: the display failed at the end; the calibration is whole.
    """

    file: CalibrationFile
    paths: CalibrationPaths
    rig_seconds: float
    failure: PalpateError | None

    def __repr__(self) -> str:
        found = self.file.residuals
        fit = "" if found is None else f": {found.touches} touches, residuals {found.rms_mm:.3f} mm rms"
        return f"<CalibrationAnswer {self.paths.calibration}{fit}>"


def references_from(references: ReferencesFile | PathLike | None) -> ReferencesFile:
    """References as given, from their file, or the standard ones."""
    return references if isinstance(references, ReferencesFile) else load_references(references)


def check_references(rig: RigFile, references: ReferencesFile) -> None:
    """Raise InputError for references that a rig's fingers pass above, or that its arms' links would meet."""
    build_references(references)
    room_mm, lowest = lowest_links(rig)
    highest = max(rig.fingers, key=lambda finger: finger.span_mm[1])
    for name, shape in (("disc", references.disc), ("plate", references.plate)):
        if shape.height_mm <= highest.span_mm[1]:
            raise InputError(
                f"the {name} is {shape.height_mm:g} mm high, and finger {highest.name} touches at "
                f"{highest.span_mm[1]:g} mm: references must stand higher than every array"
            )
        if shape.height_mm >= room_mm:
            raise InputError(
                f"the {name} is {shape.height_mm:g} mm high, and links of finger {lowest} pass at "
                f"{room_mm:g} mm: use lower references, "
                "in a file of their own (config/references/low.toml is one)"
            )


@dataclass(frozen=True)
class CalibrationRequest:
    """Request for a calibration of the rig whose file is at `path`; fields as `Rig.calibrate` has them."""

    on_bench: RigOnBench
    path: Path
    seed: int
    steps: Sequence[str]
    references: ReferencesFile
    table: TableOperator | None
    restart: bool


def calibrate_rig(
    request: CalibrationRequest,
    progress: Callable[[str], None],
    on_session: Callable[[Path], None] | None,
) -> CalibrationAnswer:
    """Calibrate; errors as `Rig.calibrate`."""
    rig, path, seed = request.on_bench.described, request.path, request.seed
    shapes, paths = request.references, CalibrationPaths.beside(path)
    check_references(rig, shapes)
    for place in paths.all:
        check_place(place)
    keeper = RunRecordFile(paths.record)
    if request.restart:
        keeper.forget()
    bench = set_up(rig, (), seed)
    table = request.table or emulated_table(bench, seed)
    if table is None:
        raise InputError(
            f'rig "{rig.name}" is real: give the table, which puts references where they are wanted'
        )
    job = CalibrationJob(
        rig,
        hashlib.sha256(path.read_bytes()).hexdigest(),
        shapes,
        request.steps,
        _COVERAGE,
        datetime.now(UTC).replace(microsecond=0),
        _load_previous(paths.calibration, rig, path),
    )
    as_described = RigOnBench(rig, rig, None, request.on_bench.path)
    with (
        view_log(as_described, bench.clock, "calibrate", on_session) as log,
        BackgroundCall("the display", progress) as notice,
    ):

        def tell(words: str) -> None:
            if log is not None:
                log.event("said", words=words)
            notice(words)

        file = calibrate(job, rig_connector(environment(bench, log), table, notice), keeper, tell)
    write_text(paths.calibration, calibration_toml(file))
    arrays = [device.id for device in file.devices if device.kind == "array"]
    if not rig.emulated and len(arrays) == len(rig.fingers) and all(item.place for item in file.fingers):
        uids = {finger.name: uid for finger, uid in zip(rig.fingers, arrays, strict=True)}
        keep_confirmed(path, ConfirmedWiring.of(rig, uids, file.made, "calibrate"))
    write_report(paths.report, file)
    keeper.forget()
    return CalibrationAnswer(file, paths, bench.clock.now(), notice.late_failure)


def _load_previous(path: Path, rig: RigFile, rig_path: Path) -> CalibrationFile | None:
    """The calibration so far, if it is of this rig as it is now."""
    if not path.exists():
        return None
    try:
        found = load_calibration(path)
        check_calibration(found, rig, str(path), str(rig_path))
    except InputError:
        return None  # it will be replaced by one that is
    return found


@dataclass(frozen=True)
class HomedSlide:
    """A slide whose turn is known now: servo `dxl_id` counts `turns` ahead of the rig file's angles."""

    finger: str
    dxl_id: int
    turns: int


def check_homable(on_bench: RigOnBench) -> None:
    """Raise InputError for a rig without a slide of which the stops are known."""
    if not _homable_fingers(on_bench):
        raise InputError(
            f'rig "{on_bench.rig.name}" has no slide with stops_mm: there is nothing to home against; '
            "measure where slides meet their hard stops, and say so in the rig file"
        )


def home_rig(on_bench: RigOnBench, seed: int, notice: Callable[[str], None]) -> list[HomedSlide]:
    """Connect, home, disconnect. Arguments and errors as `Rig.home`."""
    check_homable(on_bench)
    names = _homable_fingers(on_bench)
    bench = replace(set_up(on_bench.described, (), seed), rig=on_bench.rig)
    with connect(bench, notice=notice) as hand:
        hand.prepare(home=HomingPolicy.ALL)
        found = [(finger.name, finger.drive.servos[1]) for finger in hand.fingers if finger.name in names]
    return [HomedSlide(name, slide.dxl_id, slide.turns) for name, slide in found]


def _homable_fingers(on_bench: RigOnBench) -> list[str]:
    """Fingers whose slides can be homed."""
    return [spec.name for spec in on_bench.rig.fingers if mechanism_of(spec).homing is not None]
