"""Servo steps of a diagnosis: firmware, supply, errors, settings, traffic and zeros."""

import math
from collections.abc import Mapping, Sequence

from palpate.base.errors import quantity
from palpate.config.diagnosis_results import Cause, FindingOut
from palpate.drivers.dynamixel import (
    HOMING_OFFSET,
    SECONDARY_ID,
    SETTINGS,
    SHUTDOWN,
    SPECIFICATIONS,
    Health,
    ItemChange,
    error_causes,
    share_supply,
    supply_warnings,
)
from palpate.rig.diagnostics.host_ports import is_timer_long
from palpate.rig.diagnostics.readings import Readings
from palpate.rig.diagnostics.servo_examination import ExaminedServo, ExaminedServos, rate_in_run_hz
from palpate.rig.diagnostics.steps import (
    BUS,
    NOTHING_TO_DO,
    DiagnosisCase,
    Judgement,
    NamedDevice,
    join_words,
    name_flag,
    name_together,
    port_failed,
    warning,
    wrong,
)

_WEAK_SUPPLY_SHARE = 0.85  # of the recommended voltage
_MAX_SUPPLY_DROP_V = 1.0  # between servos of one supply whose motors are off
_MAX_LOST_SHARE = 0.001  # share of answers
_MIN_LOST_ANSWERS = 3
_REVERSE_MODE_BIT = 0x01
_MAX_ITEMS_NAMED = 4
_WARM_MARGIN_C = 10  # below the limit
_BUSY_FACTOR = 2.0  # times what wire and latency timer take, from which a computer is said to be busy

_END_OTHERS = (
    "end other programs, then run this again: if it is no better, plug the adapter in directly, without a hub"
)

_SETTING_CAUSES = {
    HOMING_OFFSET: Cause.HOMING_OFFSET,
    SECONDARY_ID: Cause.SHADOW_ID,
    SHUTDOWN: Cause.PROTECTION_OFF,
}


def judge_firmware(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Servos whose firmware is too old."""
    if readings.servos is None:
        return port_failed(case, str(readings.bus_error))
    seen = readings.servos.servos
    findings = [
        wrong(
            Cause.SERVO_FIRMWARE,
            item.device,
            f"its firmware {item.firmware} does not know all items that runs need",
            "it is too old: a run relies on Drive Mode and Bus Watchdog, for instance",
            "update it with the vendor's DYNAMIXEL Wizard 2.0",
        )
        for item in seen
        if item.old
    ]
    kinds = sorted({(item.model.name, item.firmware) for item in seen if item.firmware is not None})
    return join_words([f"{firmware} ({name})" for name, firmware in kinds]), findings


def _read_servos(readings: Readings) -> list[tuple[ExaminedServo, Health]]:
    return [(item, item.health) for item in readings.examined if item.health is not None]


def judge_supply(_case: DiagnosisCase, readings: Readings) -> Judgement:
    """Voltages beside servos' limits, what they are made for, and each other."""
    there = _read_servos(readings)
    volts = [health.voltage_v for _, health in there]
    low = [item for item, health in there if health.voltage_v < _made_limits_v(item)[0]]
    high = [item for item, health in there if health.voltage_v > _made_limits_v(item)[1]]
    weak = [
        item
        for item, health in there
        if item not in low and health.voltage_v < _WEAK_SUPPLY_SHARE * _nominal(item)
    ]
    servos = [item for item, _ in there]
    findings = [_supply_mix(text, servos) for text in supply_warnings(item.model.name for item in servos)]
    if low:
        findings.append(_low(low, len(there), serious=True))
    if high:
        findings.append(_high(high))
    if weak and not low:
        findings.append(_low(weak, len(there), serious=False))
    if not (low or high or weak):
        findings += _drop(there)
    return _span(volts), findings


def _drop(there: Sequence[tuple[ExaminedServo, Health]]) -> list[FindingOut]:
    """A servo of several alike that less voltage reaches than the others."""
    by_voltage = sorted(there, key=lambda pair: pair[1].voltage_v)
    (worst, least), (_, most) = by_voltage[0], by_voltage[-1]
    same = len({item.model.name for item, _ in there}) == 1
    if not same or most.voltage_v - least.voltage_v <= _MAX_SUPPLY_DROP_V:
        return []
    return [
        warning(
            Cause.SUPPLY_DROP,
            worst.device,
            f"{least.voltage_v:.1f} V reach it, and {most.voltage_v:.1f} V another servo of the bus",
            "plugs or cables on the way to it take that much",
            f"check plugs and cables before servo {worst.dxl_id}",
        )
    ]


def _span(volts: Sequence[float]) -> str:
    low, high = min(volts), max(volts)
    return f"{low:.1f} V" if low == high else f"{low:.1f} to {high:.1f} V"


def _supply_mix(text: str, servos: Sequence[ExaminedServo]) -> FindingOut:
    saw, _, rest = text.partition(": ")
    means, _, do = rest.partition("; ")
    every = name_together("all servos", (item.device for item in servos))
    make = warning if share_supply(item.model.name for item in servos) else wrong
    return make(Cause.SUPPLY_MIXED, every, saw, means, do)


def _low(items: Sequence[ExaminedServo], there: int, *, serious: bool) -> FindingOut:
    every = len(items) == there
    make = wrong if serious else warning
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
        Cause.SUPPLY_LOW, _together(items), f"{_volts(items)}, and {_limits(items[0])} are allowed", means, do
    )


def _high(items: Sequence[ExaminedServo]) -> FindingOut:
    return wrong(
        Cause.SUPPLY_HIGH,
        _together(items),
        f"{_volts(items)}, and {_limits(items[0])} are allowed",
        "the supply gives too much, which destroys servos",
        f"switch the supply off now, and set it to {_nominal(items[0]):g} V",
    )


def judge_hardware(_case: DiagnosisCase, readings: Readings) -> Judgement:
    """Servos that are hot or warm, or report an error that supply and heat do not explain."""
    there = _read_servos(readings)
    findings = [
        found for item, health in there for found in (*_heat(item, health), *_latched_error(item, health))
    ]
    errors = sum(bool(health.hardware_error) for _, health in there)
    reported = f"{quantity(errors, 'servo reports', 'servos report')} an error" if errors else "none reported"
    return f"{reported}, {max(health.temperature_c for _, health in there)} °C at most", findings


def _heat(item: ExaminedServo, health: Health) -> list[FindingOut]:
    found, limit = health.temperature_c, item.expected.get("Temperature Limit", health.temperature_limit_c)
    if found >= limit:
        saw, means = f"{found} °C, its limit is {limit} °C", "it lets go, and a run ends"
        do = "switch its supply off and let it cool down, then see by hand if its joint binds"
        return [wrong(Cause.TOO_HOT, item.device, saw, means, do)]
    if found >= limit - _WARM_MARGIN_C:
        saw, means = f"it is warm: {found} °C of {limit} °C", "at its limit it lets go, and a run ends"
        return [warning(Cause.WARM, item.device, saw, means, "let it cool down, and see if its joint binds")]
    return []


def _latched_error(item: ExaminedServo, health: Health) -> list[FindingOut]:
    errors = health.hardware_error & ~health.outside_limits
    for change in item.foreign:
        errors &= ~SETTINGS[change.item].limits
    if not errors:
        return []
    saw = f"it has latched a hardware error: {join_words([name_flag(flag) for flag in errors])}"
    means = f"{error_causes(errors)}; it refuses torque until it is restarted"
    do = f"remove the cause, then palpate reboot --id {item.dxl_id}"
    return [wrong(Cause.HARDWARE_ERROR, item.device, saw, means, do)]


def judge_torque(_case: DiagnosisCase, readings: Readings) -> Judgement:
    """Servos whose torque is on."""
    on = [item for item, health in _read_servos(readings) if health.torque_on]
    if not on:
        return "off everywhere", []
    finding = wrong(
        Cause.TORQUE_ON,
        _together(on),
        "torque is on, and nothing should hold it now",
        "it cannot be moved by hand, and what else writes to the bus may move it",
        "palpate stop; if it is on again then, another program still writes to the bus: end that",
    )
    return f"on in {quantity(len(on), 'servo', 'servos')}", [finding]


def judge_settings(_case: DiagnosisCase, readings: Readings) -> Judgement:
    """Limits, modes and directions in EEPROM, beside what a run wants."""
    there = [item for item, _ in _read_servos(readings)]
    findings = [_unable(item) for item in readings.examined if item.unable]
    findings += [finding for item in there for finding in _foreign(item, there)]
    unset = {item: changes for item in there if (changes := _unset(item))}
    if unset:
        findings.append(_limits_not_set(unset))
    return (
        f"as runs want them in {len(there) - len(unset)} of {quantity(len(there), 'servo', 'servos')}",
        findings,
    )


def _unset(item: ExaminedServo) -> list[ItemChange]:
    """Items that the next run writes."""
    left_out = "Drive Mode" if _is_reversed(item) else None
    return [change for change in item.differing if change.item != left_out]


def _limits_not_set(unset: Mapping[ExaminedServo, Sequence[ItemChange]]) -> FindingOut:
    first, changes = next(iter(unset.items()))
    shown = join_words(
        [f"{item.item} {item.found} instead of {item.wanted}" for item in changes], _MAX_ITEMS_NAMED, "items"
    )
    return warning(
        Cause.LIMITS_NOT_SET,
        _together(list(unset)),
        f"{quantity(sum(map(len, unset.values())), 'item', 'items')} of EEPROM not as runs want them "
        f"(servo {first.dxl_id}: {shown})",
        "limits, modes and speeds are not in the servos yet; runs write them first",
        f"{NOTHING_TO_DO}: the first run writes them, palpate setup-motors at once",
    )


def _unable(item: ExaminedServo) -> FindingOut:
    saw, _, do = str(item.failure).rpartition("; ")
    why = "the rig file wants limits that this model cannot keep"
    return wrong(Cause.LIMITS_IMPOSSIBLE, item.device, saw, why, do)


def _foreign(item: ExaminedServo, there: Sequence[ExaminedServo]) -> list[FindingOut]:
    """Settings that another program has left, and that no run writes."""
    findings = []
    if _is_reversed(item):
        findings.append(
            wrong(
                Cause.DRIVE_REVERSED,
                item.device,
                f"its Drive Mode is {item.setting('Drive Mode')}: it counts angles in the reverse direction",
                "a run writes normal direction; signs and zeros measured as it is now are wrong then",
                f"palpate setup-motors --id {item.dxl_id}",
            )
        )
    for change in item.foreign:
        make = wrong if _stops_runs(item, change, there) else warning
        cause = _SETTING_CAUSES.get(change.item, Cause.FOREIGN_SETTING)
        remedy = change.remedy(item.dxl_id)
        if item.health is not None and SETTINGS[change.item].limits & item.health.hardware_error:
            remedy += f"; then palpate reboot --id {item.dxl_id}"
        findings.append(make(cause, item.device, f"its {change}", change.effect, remedy))
    return findings


def _stops_runs(item: ExaminedServo, change: ItemChange, there: Sequence[ExaminedServo]) -> bool:
    """True if a run refuses the servo as it is, or ends by what it reports."""
    if change.item == SECONDARY_ID:
        return any(other.dxl_id == change.found for other in there)
    reported = 0 if item.health is None else item.health.hardware_error | item.health.outside_limits
    return change.item == HOMING_OFFSET or bool(SETTINGS[change.item].limits & reported)


def judge_traffic(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Answers that were lost or late, and how often all servos can be read."""
    seen = readings.servos
    assert seen is not None, "the step needs servos"
    findings = _answer_loss(seen) or _late_answers(seen) or _slow_reads(case, readings, seen)
    rate = "not read together" if seen.loop is None else f"{seen.loop.rate_hz:.0f} reads of all a second"
    return f"{rate}, {seen.lost} of {seen.counts.instructions} answers lost", findings


def _answer_loss(seen: ExaminedServos) -> list[FindingOut]:
    failed = [item for item in seen.servos if item.failure is not None and not (item.old or item.unable)]
    asked = seen.counts.instructions
    many = seen.lost >= _MIN_LOST_ANSWERS and seen.lost > _MAX_LOST_SHARE * asked
    if not (many or failed or seen.loop_failure):
        return []
    saw = f"{seen.lost} of {asked} answers were lost or damaged"
    saw += f"; {_together(failed).name} could not be read" if failed else ""
    saw += f"; the servos cannot be read together: {seen.loop_failure}" if seen.loop_failure else ""
    means = "a run waits for what is lost, and ends where a servo stays silent"
    do = (
        "move every plug of the bus once, then run this again: if as much is lost, take a shorter cable, "
        "apart from motor cables, and join the grounds"
    )
    device = name_together(BUS.name, (item.device for item in failed))
    return [wrong(Cause.BUS_LOSSY, device, saw, means, do)]


def _late_answers(seen: ExaminedServos) -> list[FindingOut]:
    if not seen.counts.stale:
        return []
    saw = f"{seen.counts.stale} of {seen.counts.instructions} answers came late or twice"
    means = "a run takes an answer that comes late for silence"
    return [warning(Cause.BUS_SLOW, BUS, saw, means, _END_OTHERS)]


def _slow_reads(case: DiagnosisCase, readings: Readings, seen: ExaminedServos) -> list[FindingOut]:
    """Reads of all servos that take much longer than wire and adapter need, or are too few a second."""
    loop, wanted = seen.loop, case.rig.closing.sample_rate_hz
    if loop is None:
        return []
    findings = []
    timer_s = readings.timers_s[case.rig.bus.port]
    if loop.p99_ms > _BUSY_FACTOR * (loop.wire_ms + (timer_s or 0.0) * 1e3):
        findings.append(
            warning(
                Cause.COMPUTER_BUSY,
                BUS,
                f"one in a hundred reads of all servos takes more than {loop.p99_ms:.1f} ms, the wire alone "
                f"{loop.wire_ms:.1f} ms",
                "a run takes an answer that comes late for silence",
                _END_OTHERS,
            )
        )
    if rate_in_run_hz(loop, seen.delays_s) < wanted and not is_timer_long(timer_s):
        findings.append(
            warning(
                Cause.BUS_SLOW,
                BUS,
                f"all servos can be read {loop.rate_hz:.0f} times a second, sample_rate_hz is {wanted:g}",
                "reading takes longer than a sample; a run goes more slowly than it could",
                "set a higher baud rate: baudrate_bps in the rig file, then palpate setup-motors",
            )
        )
    return findings


def _list_starts(case: DiagnosisCase, readings: Readings) -> dict[str, str | None]:
    """Reasons why a run would not start from where fingers stand, None without; by finger, where known."""
    if readings.servos is None:
        return {}
    backward = {item.dxl_id for item in readings.examined if _is_reversed(item)}
    spoiled = {
        finger.name
        for finger in case.rig.fingers
        if backward & {servo.dxl_id for servo in finger.servos.values()}
    }
    return {name: problem for name, problem in readings.servos.starts.items() if name not in spoiled}


def need_start(case: DiagnosisCase, readings: Readings) -> str | None:
    """The need of a finger of which it is known where it stands."""
    known = _list_starts(case, readings)
    return None if known else "no finger has two servos that can be read and count as the rig file says"


def judge_zeros(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Fingers that do not stand where a run may start."""
    starts = _list_starts(case, readings)
    ids = {finger.name: tuple(item.dxl_id for item in finger.servos.values()) for finger in case.rig.fingers}
    findings = [
        wrong(
            Cause.ZERO_OFF,
            NamedDevice(f"finger {name}", ids[name]),
            problem.partition("; ")[0],
            "it was pushed there by hand, or zeros in the rig file are off",
            problem.partition("; ")[2],
        )
        for name, problem in starts.items()
        if problem is not None
    ]
    left = [finger.name for finger in case.rig.fingers if finger.name not in starts]
    more = f"; not looked at: {join_words(left)}" if left else ""
    fine = quantity(len(starts), "finger", "fingers")
    return f"{len(starts) - len(findings)} of {fine} where a run may start{more}", findings


def _is_reversed(item: ExaminedServo) -> bool:
    return bool((item.setting("Drive Mode") or 0) & _REVERSE_MODE_BIT) and item.wanted.get("Drive Mode") == 0


def _nominal(item: ExaminedServo) -> float:
    found = SPECIFICATIONS.get(item.model.name)
    low = 0.0 if item.health is None else item.health.voltage_limits_v[0]
    return low if found is None else found.nominal_v


def _together(items: Sequence[ExaminedServo]) -> NamedDevice:
    if len(items) == 1:
        return items[0].device
    name = f"servos {join_words([str(item.dxl_id) for item in items])}"
    return name_together(name, (item.device for item in items))


def _volts(items: Sequence[ExaminedServo]) -> str:
    return _span([item.health.voltage_v for item in items if item.health is not None])


def _limits(item: ExaminedServo) -> str:
    return "{:.1f} to {:.1f} V".format(*_made_limits_v(item))


def _made_limits_v(item: ExaminedServo) -> tuple[float, float]:
    """Least and largest supply that its model is made for: its own limits may be another program's."""
    table = item.model.table or {}
    if "Min Voltage Limit" not in table:
        return (0.0, math.inf) if item.health is None else item.health.voltage_limits_v
    return table["Min Voltage Limit"].default / 10, table["Max Voltage Limit"].default / 10
