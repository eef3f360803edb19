"""Servo steps of a diagnosis: firmware, supply, errors, settings, traffic and zeros."""

from collections.abc import Callable, Sequence

from palpate.base.errors import quantity
from palpate.config.diagnosis_results import Cause, DoctorStepOut, FindingOut
from palpate.drivers.dynamixel import SPECIFICATIONS, HardwareError, supply_warnings
from palpate.rig.diagnostics.servo_examination import ExaminedServo, ExaminedServos, rate_in_run_hz
from palpate.rig.diagnostics.steps import (
    NOTHING_TO_DO,
    DiagnosisCase,
    error_finding,
    finish_step,
    join_words,
    skip_step,
    warning_finding,
)

_WEAK_SUPPLY_SHARE = 0.85  # of the recommended voltage
_MAX_SUPPLY_DROP_V = 1.0  # between servos of one supply whose motors are off
_MAX_LOST_SHARE = 0.001  # share of answers
_MIN_LOST_ANSWERS = 3
_NO_SECONDARY_ID = 253  # ids from here on mean none
_PROTECTION_BITS = 0x24  # overload and overheating
_REVERSE_MODE_BIT = 0x01
_MAX_ITEMS_NAMED = 4

_ERROR_CAUSES = {
    HardwareError.INPUT_VOLTAGE: "its supply left its limits, as a weak one does when motors pull",
    HardwareError.OVERHEATING: "it has been too hot",
    HardwareError.MOTOR_ENCODER: "its encoder or motor does not work",
    HardwareError.ELECTRICAL_SHOCK: "its electronics were shocked, or its motor has too little power",
    HardwareError.OVERLOAD: "it pushed for long against something that did not give way",
}

_Judge = Callable[[DiagnosisCase, ExaminedServos], DoctorStepOut]


def judge_servos(case: DiagnosisCase, seen: ExaminedServos | None, because: str) -> list[DoctorStepOut]:
    """All steps on servos; skipped `because` if none was seen."""
    if seen is not None and seen.failure is not None:
        failed = error_finding(
            Cause.PORT_UNUSABLE,
            f"port {case.rig.bus.port}",
            seen.failure,
            "the adapter broke off while it was used",
            "plug the adapter in directly, without a hub, and run this again",
        )
        first = finish_step(*_STEPS[0], "the port failed", [failed])
        return [first, *(skip_step(*name, "the bus's port failed") for name in _STEPS[1:])]
    if seen is None or not seen.servos:
        return [skip_step(*name, because) for name in _STEPS]
    return [judge(case, seen) for judge in _JUDGES]


def _firmware(case: DiagnosisCase, seen: ExaminedServos) -> DoctorStepOut:
    del case
    findings = [
        error_finding(
            Cause.SERVO_FIRMWARE,
            item.name,
            f"its firmware {item.firmware} does not know all items that runs need",
            "it is too old: a run relies on Drive Mode and Bus Watchdog, for instance",
            "update it with the vendor's DYNAMIXEL Wizard 2.0",
        )
        for item in seen.servos
        if item.old
    ]
    kinds = sorted({(item.model.name, item.firmware) for item in seen.servos if item.firmware is not None})
    saw = join_words([f"{firmware} ({name})" for name, firmware in kinds])
    return finish_step(*_STEPS[0], saw, findings)


def _supply(case: DiagnosisCase, seen: ExaminedServos) -> DoctorStepOut:
    del case
    there = [(item, item.health) for item in seen.servos if item.health is not None]
    if not there:
        return skip_step(*_STEPS[1], "no servo could be read")
    volts = [health.voltage_v for _, health in there]
    low = [item for item, health in there if health.voltage_v < health.voltage_limits_v[0]]
    high = [item for item, health in there if health.voltage_v > health.voltage_limits_v[1]]
    weak = [
        item
        for item, health in there
        if item not in low and health.voltage_v < _WEAK_SUPPLY_SHARE * _nominal(item)
    ]
    findings = [_mixed(text) for text in supply_warnings(item.model.name for item, _ in there)]
    if low:
        findings.append(_low(low, len(there), serious=True))
    if high:
        findings.append(_high(high))
    if weak and not low:
        findings.append(_low(weak, len(there), serious=False))
    same = len({item.model.name for item, _ in there}) == 1
    if not (low or high or weak) and same and max(volts) - min(volts) > _MAX_SUPPLY_DROP_V:
        worst = min(there, key=lambda pair: pair[1].voltage_v)[0]
        findings.append(
            warning_finding(
                Cause.SUPPLY_DROP,
                worst.name,
                f"{min(volts):.1f} V reach it, and {max(volts):.1f} V another servo of the bus",
                "a plug or a cable on the way to it has too much resistance",
                f"check plugs and cables before servo {worst.dxl_id}",
            )
        )
    saw = f"{min(volts):.1f} V" if min(volts) == max(volts) else f"{min(volts):.1f} to {max(volts):.1f} V"
    return finish_step(*_STEPS[1], saw, findings)


def _mixed(text: str) -> FindingOut:
    saw, _, rest = text.partition(": ")
    means, _, do = rest.partition("; ")
    return warning_finding(Cause.SUPPLY_MIXED, "all servos", saw, means, do)


def _low(items: Sequence[ExaminedServo], there: int, *, serious: bool) -> FindingOut:
    every = len(items) == there
    make = error_finding if serious else warning_finding
    means = (
        "the supply gives too little, or is the wrong one"
        if every
        else "others have more: a cable or plug on the way to it loses voltage"
    )
    do = (
        f"set the supply to {_nominal(items[0]):g} V"
        if every
        else f"check cables and plugs before servo {items[0].dxl_id}"
    )
    return make(
        Cause.SUPPLY_LOW, _names(items), f"{_volts(items)}, and {_limits(items[0])} are allowed", means, do
    )


def _high(items: Sequence[ExaminedServo]) -> FindingOut:
    return error_finding(
        Cause.SUPPLY_HIGH,
        _names(items),
        f"{_volts(items)}, and {_limits(items[0])} are allowed",
        "the supply gives too much, which destroys servos",
        f"switch the supply off now, and set it to {_nominal(items[0]):g} V",
    )


def _hardware(case: DiagnosisCase, seen: ExaminedServos) -> DoctorStepOut:
    del case
    findings = []
    for item in seen.servos:
        health = item.health
        if health is None:
            continue
        hot = health.temperature_c >= health.temperature_limit_c
        if hot:
            findings.append(
                error_finding(
                    Cause.TOO_HOT,
                    item.name,
                    f"{health.temperature_c} °C, its limit is {health.temperature_limit_c} °C",
                    "it has worked hard for long, or its joint binds",
                    "switch its supply off and let it cool down",
                )
            )
        low, high = health.voltage_limits_v
        explained = HardwareError.OVERHEATING if hot else HardwareError(0)
        explained |= HardwareError(0) if low <= health.voltage_v <= high else HardwareError.INPUT_VOLTAGE
        left = health.hardware_error & ~explained
        if left:
            findings.append(_latched(item, left))
    temperatures = [item.health.temperature_c for item in seen.servos if item.health is not None]
    errors = sum(bool(item.health and item.health.hardware_error) for item in seen.servos)
    reported = f"{quantity(errors, 'servo reports', 'servos report')} an error" if errors else "none reported"
    saw = f"{reported}, {max(temperatures)} °C at most" if temperatures else "no servo could be read"
    return finish_step(*_STEPS[2], saw, findings)


def _latched(item: ExaminedServo, errors: HardwareError) -> FindingOut:
    names = join_words([str(flag.name).replace("_", " ").lower() for flag in errors])
    causes = join_words([_ERROR_CAUSES[flag] for flag in errors])
    return error_finding(
        Cause.HARDWARE_ERROR,
        item.name,
        f"it has latched a hardware error: {names}",
        f"{causes}; it refuses torque until it is restarted",
        "remove the cause, then switch the servos' supply off and on",
    )


def _torque(case: DiagnosisCase, seen: ExaminedServos) -> DoctorStepOut:
    on = [item for item in seen.servos if item.health is not None and item.health.torque_on]
    findings = []
    if on:
        findings.append(
            error_finding(
                Cause.TORQUE_ON,
                _names(on),
                "torque is on, and nothing should hold it now",
                "another program left it on, or still runs",
                case.command("palpate stop --rig RIG"),
            )
        )
    return finish_step(
        *_STEPS[3], f"on in {quantity(len(on), 'servo', 'servos')}" if on else "off everywhere", findings
    )


def _settings(case: DiagnosisCase, seen: ExaminedServos) -> DoctorStepOut:
    there = [item for item in seen.servos if item.health is not None]
    unable = [_unable(item) for item in seen.servos if item.unable]
    if not there and not unable:
        return skip_step(*_STEPS[4], "no servo could be read")
    findings = unable + [finding for item in there for finding in _special(case, item, there)]
    unset = {
        item: {
            name: pair
            for name, pair in item.differing.items()
            if not _is_reversed(item) or name != "Drive Mode"
        }
        for item in there
    }
    unset = {item: pairs for item, pairs in unset.items() if pairs}
    if unset:
        first, pairs = next(iter(unset.items()))
        shown = join_words(
            [f"{name} {found} instead of {value}" for name, (found, value) in pairs.items()], _MAX_ITEMS_NAMED
        )
        findings.append(
            warning_finding(
                Cause.LIMITS_NOT_SET,
                _names(list(unset)),
                f"{quantity(sum(map(len, unset.values())), 'item', 'items')} of EEPROM not as runs want them "
                f"(servo {first.dxl_id}: {shown})",
                "limits of current and position are not in the servos yet; runs write them first",
                f"{NOTHING_TO_DO}: the first run writes them",
            )
        )
    saw = f"as runs want them in {len(there) - len(unset)} of {quantity(len(there), 'servo', 'servos')}"
    return finish_step(*_STEPS[4], saw, findings)


def _unable(item: ExaminedServo) -> FindingOut:
    saw, _, do = str(item.failure).rpartition("; ")
    why = "the rig file wants limits that this model cannot keep"
    return error_finding(Cause.LIMITS_IMPOSSIBLE, item.name, saw, why, do)


def _special(case: DiagnosisCase, item: ExaminedServo, there: Sequence[ExaminedServo]) -> list[FindingOut]:
    """Settings that spoil more than a limit."""
    findings = []
    again = case.command(f"palpate setup-motors --rig RIG --id {item.dxl_id}")
    if _is_reversed(item):
        findings.append(
            error_finding(
                Cause.DRIVE_REVERSED,
                item.name,
                f"its Drive Mode is {item.setting('Drive Mode')}: it counts angles in the reverse direction",
                "a run writes normal direction; signs and zeros measured as it is now are wrong then",
                again,
            )
        )
    offset = item.setting("Homing Offset")
    if offset:
        findings.append(
            warning_finding(
                Cause.HOMING_OFFSET,
                item.name,
                f"its Homing Offset is {offset} steps ({offset / 4096 * 360:.1f}°)",
                "its angles are shifted by that much, which the rig file's zero must contain",
                "write 0 to it with DYNAMIXEL Wizard 2.0, unless the zero was measured with it",
            )
        )
    shadow = item.setting("Secondary(Shadow) ID")
    twin = next((other for other in there if other.dxl_id == shadow and other is not item), None)
    if shadow is not None and shadow < _NO_SECONDARY_ID and twin is not None:
        findings.append(
            error_finding(
                Cause.SHADOW_ID,
                item.name,
                f"its Secondary ID is {shadow}, the id of {twin.name}",
                f"it does silently whatever servo {shadow} is told to do",
                "write 255 to its Secondary ID with DYNAMIXEL Wizard 2.0",
            )
        )
    shutdown = item.setting("Shutdown")
    if shutdown is not None and shutdown & _PROTECTION_BITS != _PROTECTION_BITS:
        findings.append(
            warning_finding(
                Cause.PROTECTION_OFF,
                item.name,
                f"its Shutdown is {shutdown:#04x}: it stays on when overloaded or too hot",
                "somebody has switched its protection off",
                "write its default (52) to Shutdown with DYNAMIXEL Wizard 2.0",
            )
        )
    return findings


def _traffic(case: DiagnosisCase, seen: ExaminedServos) -> DoctorStepOut:
    findings = []
    failed = [item for item in seen.servos if item.failure is not None and not (item.old or item.unable)]
    if (seen.lost >= _MIN_LOST_ANSWERS and seen.lost > _MAX_LOST_SHARE * seen.asked) or failed:
        findings.append(
            error_finding(
                Cause.BUS_LOSSY,
                "the servos' bus",
                f"{seen.lost} of {seen.asked} answers were lost or damaged"
                + (f"; {_names(failed)} could not be read" if failed else ""),
                "a plug is loose, a cable is too long or lies beside motor cables, or grounds are not joined",
                "move every plug of the bus once, then run this again",
            )
        )
    elif seen.stale:
        findings.append(
            warning_finding(
                Cause.BUS_SLOW,
                "the servos' bus",
                f"{seen.stale} of {seen.asked} answers came late or twice",
                "the computer is busy, or the adapter holds answers back",
                "close other programs, then run this again",
            )
        )
    wanted, loop = case.rig.closing.sample_rate_hz, seen.loop
    delays = [item.return_delay_s for item in seen.servos if item.health is not None]
    timer = case.computer.latency_timer_s(case.rig.bus.port)
    slow = loop is not None and rate_in_run_hz(loop, delays) < wanted
    if loop is not None and slow and not findings and not (timer and timer > 1e-3):
        findings.append(
            warning_finding(
                Cause.BUS_SLOW,
                "the servos' bus",
                f"all servos can be read {loop.rate_hz:.0f} times a second, sample_rate_hz is {wanted:g}",
                "reading takes longer than a sample; a run goes more slowly than it could",
                "set a higher baud rate: baudrate_bps in the rig file, then palpate setup-motors",
            )
        )
    rate = "not read together" if loop is None else f"{loop.rate_hz:.0f} reads of all a second"
    return finish_step(*_STEPS[5], f"{rate}, {seen.lost} of {seen.asked} answers lost", findings)


def _zeros(case: DiagnosisCase, seen: ExaminedServos) -> DoctorStepOut:
    spoiled = {
        finger.name
        for finger in case.rig.fingers
        for item in seen.servos
        if _is_reversed(item) and item.dxl_id in [servo.dxl_id for servo in finger.servos.values()]
    }
    starts = {name: problem for name, problem in seen.starts.items() if name not in spoiled}
    if not starts:
        return skip_step(
            *_STEPS[6], "no finger has two servos that can be read and count as the rig file says"
        )
    findings = [
        error_finding(
            Cause.ZERO_OFF,
            f"finger {name}",
            problem.partition("; ")[0],
            "it was pushed there by hand, or zeros in the rig file are off",
            problem.partition("; ")[2],
        )
        for name, problem in starts.items()
        if problem is not None
    ]
    left = [finger.name for finger in case.rig.fingers if finger.name not in starts]
    more = f"; not looked at: {join_words(left)}" if left else ""
    fine = len(starts) - len(findings)
    return finish_step(
        *_STEPS[6],
        f"{fine} of {quantity(len(starts), 'finger', 'fingers')} where a run may start{more}",
        findings,
    )


def _is_reversed(item: ExaminedServo) -> bool:
    return bool((item.setting("Drive Mode") or 0) & _REVERSE_MODE_BIT) and item.wanted.get("Drive Mode") == 0


def _nominal(item: ExaminedServo) -> float:
    found = SPECIFICATIONS.get(item.model.name)
    low = 0.0 if item.health is None else item.health.voltage_limits_v[0]
    return low if found is None else found.nominal_v


def _names(items: Sequence[ExaminedServo]) -> str:
    if len(items) == 1:
        return items[0].name
    return f"servos {join_words([str(item.dxl_id) for item in items])}"


def _volts(items: Sequence[ExaminedServo]) -> str:
    volts = sorted(item.health.voltage_v for item in items if item.health is not None)
    return f"{volts[0]:.1f} V" if volts[0] == volts[-1] else f"{volts[0]:.1f} to {volts[-1]:.1f} V"


def _limits(item: ExaminedServo) -> str:
    assert item.health is not None
    return "{:.1f} to {:.1f} V".format(*item.health.voltage_limits_v)


_STEPS = (
    ("firmware", "read each servo's firmware"),
    ("supply voltage", "read the voltage at each servo's plug, beside its limits"),
    ("hardware errors", "read each servo's Hardware Error Status and temperature"),
    ("torque", "read whether torque is on"),
    ("settings in EEPROM", "read modes, limits and directions, beside what a run wants"),
    ("bus traffic", "read all servos over and over for a second, as a run does"),
    ("zeros", "computed from the servos' angles where fingers stand, beside where they may start"),
)
_JUDGES: tuple[_Judge, ...] = (_firmware, _supply, _hardware, _torque, _settings, _traffic, _zeros)
