"""Diagnosis of a set-up step by step, each step relying on the ones before it.

Everything is read first, then each step judges. What depends on something that failed is skipped, for single
devices as well as for whole steps: a servo that answers at another baud rate is asked nothing else, and a
cause is not reported again by its consequences. Steps for which fingers move come last, if they are asked
for. `palpate check` and `palpate doctor` are two forms of the result.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from datetime import datetime

from palpate.base.errors import DeviceError
from palpate.config import FingerConfig, RigServo
from palpate.config.diagnosis_results import (
    DEVICE_CAUSES,
    AdapterCheckOut,
    ArrayCheckOut,
    BusCountsOut,
    Cause,
    CheckOut,
    DoctorOut,
    DoctorStepOut,
    FindingOut,
    HoldCheckOut,
    Outcome,
    ServoCheckOut,
    SettingOut,
    Severity,
    WiringOut,
)
from palpate.drivers.transport import PortForbidden, PortTaken
from palpate.rig.diagnostics.array_examination import (
    ExaminedArray,
    examine_arrays,
    frame_rate_hz,
    look_at_untouched,
)
from palpate.rig.diagnostics.array_steps import (
    find_misfits,
    judge_answers,
    judge_geometry,
    judge_scale,
    judge_taxels,
)
from palpate.rig.diagnostics.bus_steps import judge_baud_rate, judge_ids, judge_models, scan_rig_bus
from palpate.rig.diagnostics.calibration_check import (
    Retouch,
    calibration_out,
    judge_calibration,
    need_calibrated_device,
    touch_out,
)
from palpate.rig.diagnostics.motion_checks import expect_touch_force, judge_touch_force
from palpate.rig.diagnostics.port_steps import (
    judge_existence,
    judge_latency,
    judge_permission,
    judge_use,
    open_ports,
)
from palpate.rig.diagnostics.readings import (
    Need,
    Readings,
    need_answers,
    need_array,
    need_bus_port,
    need_clear_servo,
    need_described_array,
    need_fitting_array,
    need_frames,
    need_port,
    need_read_servo,
    need_servos,
    need_settings,
    need_sound_servo,
    need_taxels,
)
from palpate.rig.diagnostics.servo_bus import list_servos
from palpate.rig.diagnostics.servo_examination import examine_servos
from palpate.rig.diagnostics.servo_steps import (
    judge_firmware,
    judge_hardware,
    judge_settings,
    judge_supply,
    judge_torque,
    judge_traffic,
    judge_zeros,
    need_start,
)
from palpate.rig.diagnostics.steps import (
    NOTHING_TO_DO,
    DiagnosisCase,
    Judgement,
    MotionStep,
    join_words,
    name_flag,
)
from palpate.rig.diagnostics.stream_steps import judge_frames, judge_noise


@dataclass(frozen=True, eq=False)
class Step:
    """A step: what it looks at, what it needs of the readings, and how it judges them."""

    name: str
    looked_at: str
    needs: tuple[Need, ...]
    judge: Callable[[DiagnosisCase, Readings], Judgement]

    @property
    def about(self) -> str | None:
        """Kind of the devices that it judges one by one, "servo" or "array"; None for the rig as a whole."""
        if need_array in self.needs:
            return "array"
        return "servo" if {need_bus_port, need_sound_servo} & set(self.needs) else None

    def carry_out(self, case: DiagnosisCase, readings: Readings) -> DoctorStepOut:
        """Judge, or skip for the first need that is not met."""
        unmet = (why for need in self.needs if (why := need(case, readings)) is not None)
        because = next(unmet, None)
        judged = because if because is not None else self.judge(case, readings)
        return _result(self.name, self.looked_at, judged)


_SERVOS = (need_sound_servo, need_servos)
_ARRAYS = (need_array, need_described_array)
_FITTING = (*_ARRAYS, need_fitting_array)

STEPS = (
    Step("port is there", "opened each port of the rig file", (), judge_existence),
    Step(
        "permission",
        "whether this user may open the ports",
        (need_port(PortForbidden, PortTaken),),
        judge_permission,
    ),
    Step(
        "other programs",
        "which programs use the ports, ModemManager among them",
        (need_port(PortTaken),),
        judge_use,
    ),
    Step("latency timer", "how long adapters hold answers back", (need_port(),), judge_latency),
    Step(
        "baud rate",
        "pinged all servos at the rig file's baud rate, and at others where some are missing",
        (need_bus_port,),
        judge_baud_rate,
    ),
    Step("ids", "compared the ids that answer with the rig file's", (need_bus_port, need_answers), judge_ids),
    Step(
        "models",
        "compared the models that answer with the rig file's",
        (need_bus_port, need_answers, need_clear_servo),
        judge_models,
    ),
    Step("firmware", "read each servo's firmware", (need_sound_servo,), judge_firmware),
    Step(
        "supply voltage",
        "read the voltage at each servo's plug, beside its limits",
        (*_SERVOS, need_read_servo),
        judge_supply,
    ),
    Step(
        "hardware errors",
        "read each servo's Hardware Error Status and temperature",
        (*_SERVOS, need_read_servo),
        judge_hardware,
    ),
    Step("torque", "read whether torque is on", (*_SERVOS, need_read_servo), judge_torque),
    Step(
        "settings in EEPROM",
        "read modes, limits and directions, beside what a run wants",
        (*_SERVOS, need_settings),
        judge_settings,
    ),
    Step("bus traffic", "read all servos over and over for a second, as a run does", _SERVOS, judge_traffic),
    Step(
        "zeros",
        "computed from the servos' angles where fingers stand, beside where they may start",
        (*_SERVOS, need_start),
        judge_zeros,
    ),
    Step("arrays answer", "asked each array who it is", (need_array,), judge_answers),
    Step(
        "array geometry",
        "compared rows, columns, radius and coverage with the rig file and its calibration",
        _ARRAYS,
        judge_geometry,
    ),
    Step("frames", "counted the frames while all arrays stream at once", _FITTING, judge_frames),
    Step(
        "taxel map",
        "let arrays test themselves, and looked for taxels that are stuck or unsteady",
        (*_FITTING, need_taxels),
        judge_taxels,
    ),
    Step(
        "noise and drift",
        "compared noise and drift of the untouched taxels with what contacts need",
        (*_FITTING, need_frames),
        judge_noise,
    ),
    Step(
        "force scale",
        "compared counts per N, full scale and bits with each other and between arrays",
        (*_FITTING, need_taxels),
        judge_scale,
    ),
    Step(
        "touch force",
        "computed how hard touches press, beside what parts bear",
        (),
        judge_touch_force,
    ),
    Step(
        "calibration",
        "compared the devices that were calibrated with those that answer",
        (need_calibrated_device,),
        judge_calibration,
    ),
)
"""All steps for which nothing moves, in the order in which things go wrong."""

_NOTHING_SENT = BusCountsOut.model_validate(dict.fromkeys(BusCountsOut.model_fields, 0))
_BLOCKED = "fingers move only once nothing else is wrong"
_EXPLAINED = "first put right the wiring"
_NOT_TOUCHED = "nothing was touched: first put right what is wrong"


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Readings of a case, and all steps. `moved`: whether fingers have moved."""

    case: DiagnosisCase
    readings: Readings
    steps: tuple[DoctorStepOut, ...]
    moved: bool

    @property
    def findings(self) -> list[FindingOut]:
        """All findings, in the steps' order."""
        return [found for item in self.steps for found in item.findings]

    @property
    def emulated(self) -> bool:
        """True if the rig file or an array says so, as arrays that are served to other programs do."""
        seen = (item.description for item in self.readings.arrays)
        return self.case.rig.emulated or any(item is not None and item.emulated for item in seen)

    @property
    def well(self) -> bool:
        """True if nothing is wrong; there may be warnings."""
        return not _has_wrong(self.steps)

    @property
    def next(self) -> str | None:
        """The next thing to do: about the first wrong finding, else the first warning, and all alike."""
        open_ones = [item for item in self.findings if not item.next.startswith(NOTHING_TO_DO)]
        if not open_ones:
            return None
        first = min(open_ones, key=lambda item: item.severity is not Severity.WRONG)
        alike = [item.device for item in open_ones if (item.cause, item.next) == (first.cause, first.next)]
        return f"{join_words(alike)}: {first.next}"


def diagnose(case: DiagnosisCase, now: datetime, motions: Sequence[MotionStep] = ()) -> Diagnosis:
    """Examine a set-up, then carry out the motions, only if nothing is wrong.

    Failures of devices are findings. Raises what the motions raise.
    """
    readings = read_rig(case, now)
    steps = [step.carry_out(case, readings) for step in STEPS]
    moved = False
    for motion in motions:
        judged: Judgement | str
        if isinstance(motion.carry_out, str):
            judged = motion.carry_out
        elif _has_wrong(steps, motion.despite):
            judged = _BLOCKED
        else:
            case.tell(motion.name)
            judged = motion.carry_out()
            moved = moved or not isinstance(judged, str)
        done = _result(motion.name, motion.looked_at, judged)
        if _has_wrong([done]):
            steps = [_without(item, motion.despite) for item in steps]
        steps.append(done)
    told = (
        step.model_copy(update={"findings": tuple(map(case.with_commands, step.findings))}) for step in steps
    )
    return Diagnosis(case, readings, tuple(told), moved)


def read_rig(case: DiagnosisCase, now: datetime) -> Readings:
    """Read everything. Nothing moves, torque stays as it is, nothing is written to EEPROM."""
    ports = open_ports(case)
    bus, servos, error = None, None, ports[case.rig.bus.port]
    if error is None:
        try:
            bus = scan_rig_bus(case)
            servos = examine_servos(case, bus.sound) if bus.sound else None
        except DeviceError as failed:
            error = failed
    arrays = examine_arrays(case, frozenset(port for port, why in ports.items() if why is None))
    misfits = {item: find_misfits(case, item) for item in arrays if item.description is not None}
    return Readings(
        now=now,
        ports=ports,
        timers_s={port: case.computer.latency_timer_s(port) for port in ports},
        bus=bus,
        servos=servos,
        bus_error=error,
        arrays=arrays,
        misfits=misfits,
        untouched=[look_at_untouched(item) for item, found in misfits.items() if not found],
        touch_force=expect_touch_force(case.rig),
    )


def _result(name: str, looked_at: str, judged: Judgement | str) -> DoctorStepOut:
    """A step that was carried out, or skipped for a reason."""
    if isinstance(judged, str):
        return DoctorStepOut(
            step=name, outcome=Outcome.SKIPPED, looked_at=looked_at, saw="", skipped_because=judged
        )
    saw, findings = judged
    worst = {item.severity for item in findings}
    outcome = Outcome.WARNING if worst else Outcome.WELL
    if Severity.WRONG in worst:
        outcome = Outcome.WRONG
    return DoctorStepOut(step=name, outcome=outcome, looked_at=looked_at, saw=saw, findings=tuple(findings))


def _without(step: DoctorStepOut, causes: Collection[Cause]) -> DoctorStepOut:
    """A step, skipped if some causes, for which there is a reason now, are among its findings."""
    explained = any(item.cause in causes for item in step.findings)
    return _result(step.step, step.looked_at, _EXPLAINED) if explained else step


def _has_wrong(steps: Sequence[DoctorStepOut], but: Collection[Cause] = ()) -> bool:
    found = (item for step in steps for item in step.findings)
    return any(item.severity is Severity.WRONG and item.cause not in but for item in found)


def doctor_out(found: Diagnosis, wiring: WiringOut | None = None) -> DoctorOut:
    """The result of `palpate doctor`: the steps."""
    return DoctorOut(
        rig=found.case.rig.name,
        emulated=found.emulated,
        well=found.well,
        device_missing=any(item.cause in DEVICE_CAUSES for item in found.findings),
        moved=found.moved,
        wiring=wiring,
        steps=found.steps,
        next=found.next,
    )


def check_out(
    found: Diagnosis, measured: Retouch | HoldCheckOut | None = None, wiring: WiringOut | None = None
) -> CheckOut:
    """The result of `palpate check`: every device, what fingers have measured, and findings in words.

    Raises DeviceError if the bus's port is missing or has failed: then there is no rig to check.
    """
    if found.readings.bus_error is not None:
        raise found.readings.bus_error
    rig, readings = found.case.rig, found.readings
    servos, arrays = (
        readings.servos,
        [_array_out(found, spec) for spec in rig.fingers if spec.array.has_device],
    )
    timer = readings.timers_s[rig.bus.port]
    calibration = calibration_out(found.case, readings)
    if calibration is not None and isinstance(measured, Retouch):
        calibration = calibration.model_copy(update={"touch": touch_out(measured)})
    blocked = any(item.skipped_because == _BLOCKED for item in found.steps)
    return CheckOut(
        rig=rig.name,
        emulated=found.emulated,
        well=found.well,
        adapter=AdapterCheckOut(
            port=rig.bus.port,
            baudrate_bps=rig.bus.baudrate_bps,
            latency_timer_ms=None if timer is None else timer * 1e3,
        ),
        servos=tuple(_servo_out(found, servo) for servo in list_servos(rig)),
        arrays=tuple(arrays),
        loop=None if servos is None else servos.loop,
        bus=_NOTHING_SENT if servos is None else servos.counts,
        calibration=calibration,
        touch_force=readings.touch_force,
        hold=measured if isinstance(measured, HoldCheckOut) else None,
        wiring=wiring,
        problems=in_words(found.findings, Severity.WRONG),
        warnings=in_words(found.findings, Severity.WARNING) + ((_NOT_TOUCHED,) if blocked else ()),
        steps=found.steps,
        next=found.next,
    )


def in_words(findings: Sequence[FindingOut], severity: Severity, *, named: bool = True) -> tuple[str, ...]:
    """Findings of a severity: what was seen, and what to do next."""
    return tuple(
        (f"{item.device}: " if named else "") + f"{item.saw}; {item.next.removeprefix(f'{NOTHING_TO_DO}: ')}"
        for item in findings
        if item.severity is severity
    )


def _servo_out(found: Diagnosis, servo: RigServo) -> ServoCheckOut:
    own = [item for item in found.findings if servo.dxl_id in item.servos]
    seen = next((item for item in found.readings.examined if item.dxl_id == servo.dxl_id), None)
    named = {
        "id": servo.dxl_id,
        "owner": servo.owner,
        "model": servo.model,
        "problems": in_words(own, Severity.WRONG, named=False),
        "warnings": in_words(own, Severity.WARNING, named=False),
    }
    if seen is None or seen.health is None:
        return ServoCheckOut.model_validate(named | {"answers": False})
    return ServoCheckOut.of(
        seen.health,
        **named,
        answers=True,
        firmware=seen.firmware,
        hardware_error=tuple(name_flag(flag) for flag in seen.health.hardware_error),
        return_delay_us=round(seen.return_delay_s * 1e6),
        settings=tuple(
            SettingOut(item=change.item, found=change.found, wanted=change.wanted)
            for change in (*seen.differing, *seen.foreign)
        ),
    )


def _array_out(found: Diagnosis, spec: FingerConfig) -> ArrayCheckOut:
    own = [item for item in found.findings if spec.name in item.arrays]
    seen = next((item for item in found.readings.arrays if item.spec is spec), ExaminedArray(spec))
    timer, described = found.readings.timers_s[spec.array.port], seen.description
    blank = ArrayCheckOut(
        finger=spec.name,
        port=spec.array.port,
        protocol=spec.array.protocol,
        answers=described is not None,
        wanted_hz=found.case.rig.closing.sample_rate_hz,
        latency_timer_ms=None if timer is None else timer * 1e3,
        problems=in_words(own, Severity.WRONG, named=False),
        warnings=in_words(own, Severity.WARNING, named=False),
    )
    if described is None:
        return blank
    return blank.model_copy(
        update={
            "firmware": described.firmware,
            "unique_id": described.unique_id.hex(),
            "emulated": described.emulated,
            "shape": described.shape.name.lower(),
            "rows": described.rows,
            "columns": described.cols,
            "bad_taxels": None if seen.report is None else seen.report.bad_count,
            "rate_hz": frame_rate_hz(seen.frames),
            "lost": seen.lost,
        }
    )
