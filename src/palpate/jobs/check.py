"""Diagnosis of a rig from Python: `check`, also with touches or a pushed part, and `doctor`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Generic, TypeVar

from palpate.base.errors import DeviceError, InputError, PalpateError, warn_operator
from palpate.calibration.consistency_checks import contact_uncertainties
from palpate.config import RigOnBench, load_objects
from palpate.config.calibration_file import ReferencesFile, references_sha256
from palpate.config.diagnosis_results import (
    DEVICE_CAUSES,
    Cause,
    CheckOut,
    DoctorOut,
    DoctorStepOut,
    FindingOut,
    HoldCheckOut,
    Severity,
    WiringOut,
)
from palpate.config.fields import to_json
from palpate.config.loading import shipped_objects, shipped_rig
from palpate.config.wiring_record import ConfirmedWiring
from palpate.config.writers import change_rig, keep_confirmed
from palpate.jobs.calibration import SHIPPED_RIG, references_from
from palpate.jobs.files import PathLike
from palpate.rig.bench import BenchRig, choose_placements, connect, emulated_table, environment, set_up
from palpate.rig.commissioning.calibration_run import build_references, rig_connector
from palpate.rig.commissioning.hand_prober import TableOperator
from palpate.rig.diagnostics.calibration_check import CALIBRATION, Retouch, judge_touch, retouch
from palpate.rig.diagnostics.diagnosis import Diagnosis, check_out, diagnose, doctor_out, in_words
from palpate.rig.diagnostics.host_ports import Computer
from palpate.rig.diagnostics.motion_checks import (
    check_hold,
    judge_hold,
    least_threshold_n,
    with_light_touch,
)
from palpate.rig.diagnostics.servo_bus import BusEndpoint, endpoint_of_rig
from palpate.rig.diagnostics.steps import (
    CHECK_LISTEN_S,
    DiagnosisCase,
    Judgement,
    MotionStep,
    NamedDevice,
    warning,
    wrong,
)
from palpate.rig.diagnostics.wiring import Seen, Side
from palpate.rig.diagnostics.wiring_check import (
    EmulatedOnlooker,
    Onlooker,
    read_turns,
    rig_for_moves,
    see_moves,
    see_presses,
)
from palpate.rig.diagnostics.wiring_findings import WiringVerdict, judge_wiring
from palpate.rig.workers import BackgroundCall
from palpate.views.doctor import doctor_report

ResultT = TypeVar("ResultT", CheckOut, DoctorOut)


@dataclass(frozen=True, eq=False, repr=False)
class DiagnosisAnswer(Generic[ResultT]):
    """Findings of a diagnosis, step by step."""

    result: ResultT
    on_bench: RigOnBench

    @property
    def well(self) -> bool:
        """True if nothing is wrong; there may be warnings."""
        return self.result.well

    @property
    def device_missing(self) -> bool:
        """True if a port or device is missing or silent."""
        return any(item.cause in DEVICE_CAUSES for item in self.findings)

    @property
    def steps(self) -> Sequence[DoctorStepOut]:
        """All steps, in the order in which things go wrong."""
        return self.result.steps

    @property
    def findings(self) -> Sequence[FindingOut]:
        """Findings: cause, device, what was seen, what it means, what to do next."""
        return self.result.findings

    def apply(self) -> str:
        """Write the changes of the wiring that was found into the rig file; returns the file's new text.

        Raises InputError for the shipped rig, without changes, or if the file would not be right then.
        """
        wiring = self.result.wiring
        if wiring is None or not wiring.changes:
            raise InputError("there is nothing to change in the rig file")
        if not isinstance(self.on_bench.path, Path):
            raise InputError("the shipped rig cannot be changed: copy its rig file and check that one")
        return change_rig(self.on_bench.path, wiring.changes)

    def to_json(self) -> str:
        """The result in its published format."""
        return to_json(self.result)

    def report(self) -> str:
        """A report for a bug tracker, in Markdown: versions, steps and the rig file's relevant parts.

        Names of users, computers and folders are left out, serial numbers are hashed.
        """
        return doctor_report(self.result, self.on_bench.described)

    def __repr__(self) -> str:
        verdict = "well" if self.well else "NOT well"
        return f"<{type(self).__name__} {self.result.rig}: {verdict}; {self.result.next or 'nothing to do'}>"


@dataclass(frozen=True, eq=False, repr=False)
class CheckAnswer(DiagnosisAnswer[CheckOut]):
    """Findings of a check (`palpate/check@1`). `failure`: of the display, at the end; the check is whole."""

    failure: PalpateError | None = None

    @property
    def problems(self) -> Sequence[str]:
        """Problems, one sentence each."""
        return self.result.problems

    @property
    def warnings(self) -> Sequence[str]:
        """Warnings, one sentence each: the rig can be worked with."""
        return self.result.warnings


class DoctorAnswer(DiagnosisAnswer[DoctorOut]):
    """Findings of `Rig.doctor` (`palpate/doctor@1`)."""


Show = Callable[[str], None]
Measured = Retouch | HoldCheckOut


@dataclass
class FingerCheck:
    """A check for which fingers move: `move` moves them, tells of it, and judges what it has measured."""

    name: str
    looked_at: str
    move: Callable[[Show], tuple[Measured, Judgement]]


def touch_check(
    on_bench: RigOnBench,
    seed: int,
    references: ReferencesFile | PathLike | None,
    table: TableOperator | None,
) -> FingerCheck:
    """Touches of a disc, compared with the calibration; InputError if there is nothing to compare with."""
    shapes = _references_to_touch(on_bench, references)

    def move(show: Show) -> tuple[Retouch, Judgement]:
        found = _touch_disc(on_bench, shapes, seed, table, show)
        saw, findings = judge_touch(on_bench.rig, found)
        return found, (saw, [*_other_references(on_bench, shapes), *findings])

    return FingerCheck("touch", "touched a disc, and compared it with the calibration", move)


def hold_check(on_bench: RigOnBench, seed: int, notice: Callable[[str], None]) -> FingerCheck:
    """Pushes of the part on the table."""

    def move(show: Show) -> tuple[HoldCheckOut, Judgement]:
        found = _push_part(on_bench, seed, show, notice)
        return found, judge_hold(on_bench.rig, found)

    return FingerCheck("hold", "pushed the part until it slid", move)


def check_rig(
    on_bench: RigOnBench,
    seed: int,
    *,
    moving: FingerCheck | None,
    wiring: "WiringCheck",
    permit: Callable[[], None],
    progress: Callable[[str], None],
) -> CheckAnswer:
    """Check, and let fingers move for it if all is well; arguments and errors as `Rig.check`."""
    case = DiagnosisCase(
        on_bench, endpoint_of_rig(on_bench.described, seed), Computer(), progress, CHECK_LISTEN_S
    )
    measured: Measured | None = None
    failure: PalpateError | None = None

    def carry_out() -> Judgement:
        nonlocal measured, failure
        assert moving is not None, "it is only called then"
        permit()
        with BackgroundCall("the display", progress) as show:
            measured, judged = moving.move(show)
        failure = show.late_failure
        return judged

    motions = [] if moving is None else [MotionStep(moving.name, moving.looked_at, carry_out)]
    found = diagnose(case, datetime.now(UTC), [*motions, wiring.step(case, permit)])
    return CheckAnswer(check_out(found, measured, wiring.result(found)), on_bench, failure)


def _push_part(
    on_bench: RigOnBench, seed: int, show: Callable[[str], None], notice: Callable[[str], None]
) -> HoldCheckOut:
    """Connect, push, disconnect. On an emulated table lies what `identify` finds there by the same seed."""
    described = on_bench.described
    placements = (
        choose_placements(described, load_objects(shipped_objects()), None, seed)
        if described.emulated
        else ()
    )
    bench = replace(set_up(described, placements, seed), rig=on_bench.rig)
    with connect(bench, notice=notice) as hand:
        hand.prepare()
        quietest_n = least_threshold_n(hand)
    with connect(replace(bench, rig=with_light_touch(on_bench.rig, quietest_n)), notice=notice) as hand:
        hand.prepare()
        return check_hold(hand, lambda text: show(f"  {text}"))


def _references_to_touch(
    on_bench: RigOnBench, references: ReferencesFile | PathLike | None
) -> ReferencesFile:
    """References to be touched; InputError if there is nothing to compare touches with."""
    on_bench.rig.require("compare touches")
    if on_bench.calibration is None or contact_uncertainties(on_bench.calibration, at_rest=False) is None:
        make = f"make it with `palpate calibrate --rig {on_bench.path}`"
        remedy = SHIPPED_RIG if on_bench.path == shipped_rig() else make
        raise InputError(
            "touches are compared with a calibration, and there is none that says where all fingers "
            f"stand: {remedy}"
        )
    return references_from(references)


def _touch_disc(
    on_bench: RigOnBench,
    shapes: ReferencesFile,
    seed: int,
    table: TableOperator | None,
    show: Callable[[str], None],
) -> Retouch:
    """Connect, touch the disc, disconnect."""
    assert on_bench.calibration is not None, "refused before"
    uncertainties = contact_uncertainties(on_bench.calibration, at_rest=False)
    assert uncertainties is not None, "refused before"
    bench = set_up(on_bench.described, (), seed)
    table = table or emulated_table(bench, seed)
    if table is None:
        raise InputError(f'rig "{on_bench.rig.name}" is real: give the table, on which the disc is put')
    disc, _ = build_references(shapes)
    connect = rig_connector(environment(bench), table, show)
    with connect(on_bench.rig, moving=True) as there:
        return retouch(on_bench.rig, there.prober, disc, uncertainties, lambda text: show(f"  {text}"))


def _other_references(on_bench: RigOnBench, shapes: ReferencesFile) -> list[FindingOut]:
    """A warning if the calibration was made with other things than what is touched now."""
    assert on_bench.calibration is not None, "refused before"
    known = {item.sha256 for item in on_bench.calibration.references}
    if not known or references_sha256(shapes) in known:
        return []
    saw, means = "it was made with other references", "touches differ by as much as the disc's size does"
    do = "give theirs, or make sure that the disc is as described"
    return [warning(Cause.OTHER_REFERENCES, CALIBRATION, saw, means, do)]


@dataclass
class WiringCheck:
    """Proof of the wiring: whether tips are pressed, whether joints move, and who sees it.

    `onlooker`: None for the emulated bench's. `notice`: as `Rig.identify` has it.
    """

    press: bool
    move: bool
    onlooker: Onlooker | None = None
    notice: Callable[[str], None] = warn_operator
    verdict: WiringVerdict | None = None

    @property
    def asked(self) -> bool:
        """True if anything of it is to be done."""
        return self.press or self.move

    def step(self, case: DiagnosisCase, permit: Callable[[], None]) -> MotionStep:
        """The step; fingers move after `permit`. Raises InputError for a real rig without an onlooker."""
        if self.asked and self.onlooker is None and not case.on_bench.rig.emulated:
            raise InputError(
                f'rig "{case.rig.name}" is real: give an onlooker, who presses tips and says which one moved'
            )

        def carry_out() -> Judgement:
            try:
                return self._carry_out(case, permit)
            except DeviceError as error:
                means = "a motion did not end where it should, or a device failed; torque is off"
                do = "look at that with the supply off, then run this again"
                found = wrong(Cause.MOTION_FAILED, NamedDevice("wiring"), str(error), means, do)
                return "it could not be seen to the end", [found]

        looked = "asked which array feels a press on each tip, and which tip each joint moves"
        zeros = frozenset({Cause.ZERO_OFF})
        return MotionStep("wiring", looked, carry_out if self.asked else _NOT_ASKED, zeros)

    def _carry_out(self, case: DiagnosisCase, permit: Callable[[], None]) -> Judgement:
        bench = _bench(case.place, case.on_bench)
        watching, rig = self.onlooker or EmulatedOnlooker(bench), case.rig
        seen = Seen()
        if self.press:
            seen = replace(seen, presses=tuple(see_presses(rig, bench, watching, case.tell)))
        if self.move:
            permit()
            with environment(bench).hand(rig, self.notice) as hand:
                turns = read_turns(hand)
            with environment(bench).hand(rig_for_moves(rig, turns), self.notice) as hand:
                seen = replace(seen, moves=tuple(see_moves(hand, watching, case.tell)), turns=turns)
        self.verdict = judge_wiring(case.on_bench.described, seen)
        presses = sum(press.side is Side.FRONT for press in seen.presses)
        saw = f"{presses} tips were pressed, {len(seen.moves)} joints moved"
        return saw, self.verdict.findings

    def result(self, found: Diagnosis) -> WiringOut | None:
        """The result; where all is as it should be, that is written down beside a real rig's file."""
        if not self.asked:
            return None
        confirmed = self.press and self.move and self.verdict is not None and self.verdict.is_proof
        arrays = {item.spec.name: item.description for item in found.readings.arrays}
        uids = {
            name: described.unique_id.hex() for name, described in arrays.items() if described is not None
        }
        on_bench = found.case.on_bench
        if confirmed and isinstance(on_bench.path, Path) and not on_bench.rig.emulated:
            now = found.readings.now.replace(microsecond=0)
            keep_confirmed(on_bench.path, ConfirmedWiring.of(on_bench.described, uids, now, "check"))
        return WiringOut(
            rig=found.case.rig.name,
            emulated=found.emulated,
            confirmed=confirmed,
            changes=() if self.verdict is None else self.verdict.changes,
            problems=in_words(found.findings, Severity.WRONG),
        )


_NOT_ASKED = "people press tips and watch them for it only if asked to: palpate check --press --move"


def examine_rig(
    on_bench: RigOnBench,
    seed: int,
    *,
    wiring: WiringCheck,
    permit: Callable[[], None],
    progress: Callable[[str], None],
) -> DoctorAnswer:
    """Examine; arguments and errors as `Rig.doctor`."""
    case = DiagnosisCase(on_bench, endpoint_of_rig(on_bench.described, seed), Computer(), progress)
    found = diagnose(case, datetime.now(UTC), [wiring.step(case, permit)])
    return DoctorAnswer(doctor_out(found, wiring.result(found)), on_bench)


def _bench(place: BusEndpoint, on_bench: RigOnBench) -> BenchRig:
    """The devices that were examined: emulated ones are those of `place`."""
    found = place.devices if isinstance(place.devices, BenchRig) else set_up(on_bench.described, (), 0)
    return replace(found, urls=place.urls)
