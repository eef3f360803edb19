"""Check of a whole rig without moving it.

Each device is checked by itself, so that a silent one hides no other; then all servos are read over and
over, as a run does.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing

from palpate.base.errors import DeviceError, InputError, quantity
from palpate.config import RigFile
from palpate.config.diagnosis_results import (
    AdapterCheckOut,
    BusCountsOut,
    BusLoopOut,
    CheckOut,
    ServoCheckOut,
    TouchForceOut,
)
from palpate.drivers.dynamixel import Bus, ServoState, supply_warnings
from palpate.drivers.transport import latency_timer_s
from palpate.rig.contact_peak import expected_peak_n, unstopped_peak_n
from palpate.rig.diagnostics.array_examination import check_array
from palpate.rig.diagnostics.host_ports import timer_warnings
from palpate.rig.diagnostics.servo_bus import BusEndpoint
from palpate.rig.diagnostics.servo_examination import check_loop, check_servo, rate_in_run_hz
from palpate.rig.fingers import FingerSettings, ServoSettings, finger_settings, servo_settings, start_problem

_CORNERS_AT_ONCE = 2  # corners that a pad's face may meet
_BUSY_FACTOR = 2.0  # times what wire and latency timer take, from which a computer is said to be busy


def check_rig(rig: RigFile, place: BusEndpoint, now: Callable[[str], None] = lambda _: None) -> CheckOut:
    """Check every device of a rig; `now` is called with what is being checked.

    Raises DeviceError if the bus's port is missing or fails; everything else is in the result.
    """
    port = place.open(rig.bus.baudrate_bps)
    with closing(Bus(port, place.clock, rig.bus.baudrate_bps, latency_s=place.latency_s)) as bus:
        servos, fingers = servo_settings(rig, bus), finger_settings(rig, bus)
        found: list[ServoCheckOut] = []
        for item in servos:
            now(f"servo {item.servo.dxl_id} ({item.owner})")
            found.append(check_servo(bus, item))
        now("reading all servos")
        loop, states, problems = _read_loop(bus, place, rig, servos, found)
        counts = BusCountsOut(**bus.counts.as_dict())
    arrays = []
    for spec in rig.fingers:
        now(f"array of finger {spec.name}")
        arrays.append(check_array(rig, spec, place.clock, place.open_other))
    timer = latency_timer_s(rig.bus.port)
    adapter = AdapterCheckOut(
        port=rig.bus.port,
        baudrate_bps=rig.bus.baudrate_bps,
        latency_timer_ms=None if timer is None else timer * 1e3,
    )
    problems += [
        *(_with_name(item, text) for item in found for text in item.problems),
        *(f"array {item.finger}: {text}" for item in arrays for text in item.problems),
    ]
    touch_force = TouchForceOut(
        quick_n=expected_peak_n(rig, rig.closing.search_mm_s),
        slow_n=expected_peak_n(rig, rig.closing.touch_speed_mm_s),
        unstopped_n=unstopped_peak_n(rig),
    )
    warnings = [
        *supply_warnings(item.servo.model.name for item in servos),
        *timer_warnings(rig.bus.port, timer),
        *_servo_warnings(found),
        *(f"array {item.finger}: {text}" for item in arrays for text in item.warnings),
        *loop_warnings(loop, rig.closing.sample_rate_hz, found, timer or 0.0),
        *_count_warnings(counts, found),
        *_start_warnings(rig, fingers, states),
        *_hold_warnings(rig, touch_force),
        *_stop_warnings(rig, touch_force),
    ]
    return CheckOut(
        rig=rig.name,
        emulated=any(item.emulated for item in arrays) or rig.emulated,
        well=not problems,
        adapter=adapter,
        servos=tuple(found),
        arrays=tuple(arrays),
        loop=loop,
        bus=counts,
        touch_force=touch_force,
        problems=tuple(problems),
        warnings=tuple(warnings),
    )


def _read_loop(
    bus: Bus,
    place: BusEndpoint,
    rig: RigFile,
    servos: Sequence[ServoSettings],
    found: Sequence[ServoCheckOut],
) -> tuple[BusLoopOut | None, Mapping[int, ServoState], list[str]]:
    """The loop over all servos that can be read, where they stood, and why there is none."""
    able = [out.answers and not out.hardware_error for out in found]
    there = [item for item, is_able in zip(servos, able, strict=True) if is_able]
    if not there:
        return None, {}, []
    delays = [(out.return_delay_us or 0) / 1e6 for out, is_able in zip(found, able, strict=True) if is_able]
    try:
        loop, states = check_loop(
            bus, place.clock, [item.servo for item in there], rig.bus.baudrate_bps, delays
        )
    except (DeviceError, InputError) as error:
        return None, {}, [f"the servos cannot be read together: {error}"]
    return loop, states, []


def _with_name(servo: ServoCheckOut, text: str) -> str:
    """What is said of a servo, with its name unless that is in the text already."""
    return (
        f"{servo.owner}: {text}" if text.startswith("servo ") else f"servo {servo.id} ({servo.owner}): {text}"
    )


def _servo_warnings(found: Sequence[ServoCheckOut]) -> list[str]:
    """Warnings of servos; what is said of several with the same words is said once."""
    of_text: dict[str, list[ServoCheckOut]] = {}
    for servo in found:
        for text in servo.warnings:
            of_text.setdefault(text, []).append(servo)
    warnings = []
    for text, servos in of_text.items():
        names = ", ".join(f"{item.id} ({item.owner})" for item in servos)
        alone = _with_name(servos[0], text)
        warnings.append(alone if len(servos) == 1 else f"servos {names}: {text}")
    return warnings


def loop_warnings(
    loop: BusLoopOut | None, wanted_hz: float, found: Sequence[ServoCheckOut], timer_s: float
) -> list[str]:
    """Whether all servos are read too seldom, or much more slowly than wire and adapter need."""
    if loop is None:
        return []
    warnings = []
    if loop.p99_ms > _BUSY_FACTOR * (loop.wire_ms + timer_s * 1e3):
        warnings.append(
            f"one in a hundred reads of all servos takes more than {loop.p99_ms:.1f} ms, the wire alone "
            f"{loop.wire_ms:.1f} ms: a busy computer delays this program or served devices, and what comes "
            "too late counts as not answering; end other programs"
        )
    delays_s = [(item.return_delay_us or 0) / 1e6 for item in found if item.answers]
    if rate_in_run_hz(loop, delays_s) < wanted_hz:
        warnings.append(
            f"all servos can be read {loop.rate_hz:.0f} times a second, sample_rate_hz is {wanted_hz:g}; "
            "an adapter's latency timer of 1 ms and a higher baud rate help"
        )
    return warnings


def _count_warnings(counts: BusCountsOut, found: Sequence[ServoCheckOut]) -> list[str]:
    if counts.stale:
        came = quantity(counts.stale, "answer", "answers")
        return [
            f"{came} of {counts.instructions} came late or twice; close what keeps the computer busy, or "
            "shorten the adapter's latency timer"
        ]
    silent = counts.silent if all(item.answers for item in found) else 0
    if not (counts.damaged or silent):
        return []
    answers = quantity(counts.damaged + silent, "answer", "answers")
    return [
        f"{answers} of {counts.instructions} were damaged or lost; check cable, plugs, supply and termination"
    ]


def _hold_warnings(rig: RigFile, expected: TouchForceOut) -> list[str]:
    """Whether touches are harder than the parts are said to bear."""
    holds, peaks = rig.search.part_holds_n, (expected.quick_n, expected.slow_n)
    keys = [
        key
        for key, peak in zip(("search_speed_mm_s", "touch_speed_mm_s"), peaks, strict=True)
        if holds is not None and peak > holds
    ]
    if not keys:
        return []
    return [
        f"a touch is expected to press with {max(peaks):.2g} N, and a part may slide above part_holds_n = "
        f"{holds:g} N; lower {' and '.join(keys)} or contact_force_n"
    ]


def _stop_warnings(rig: RigFile, expected: TouchForceOut) -> list[str]:
    """Whether a touch that finds a part is so hard that the run may end by it."""
    most, quick_n = rig.closing.max_force_n, expected.quick_n
    remedy = "lower search_speed_mm_s or contact_force_n, or raise max_force_n"
    if quick_n > most:
        return [
            f"a touch that finds a part is expected to press with {quick_n:.2g} N, above max_force_n = "
            f"{most:g} N, and would end the run; {remedy}"
        ]
    pads = [finger.name for finger in rig.fingers if finger.tip.is_pad]
    if not pads or _CORNERS_AT_ONCE * quick_n <= most:
        return []
    return [
        f"{'pad' if len(pads) == 1 else 'pads'} {', '.join(pads)}: a face may meet two corners at once, each "
        f"with {quick_n:.2g} N when it finds a part; {_CORNERS_AT_ONCE * quick_n:.2g} N is above "
        f"max_force_n = {most:g} N, and would end the run; {remedy}"
    ]


def _start_warnings(
    rig: RigFile, fingers: Sequence[FingerSettings], states: Mapping[int, ServoState]
) -> list[str]:
    """Why a run would refuse to start from where fingers stand."""
    warnings = []
    for finger in fingers:
        near, far = (item.servo for item in finger.servos)
        if near.dxl_id in states and far.dxl_id in states:
            at = states[near.dxl_id].position_rad, states[far.dxl_id].position_rad
            wrong = start_problem(finger.spec, rig, (near, far), at)
            warnings += [] if wrong is None else [f"finger {finger.spec.name}: {wrong}"]
    return warnings
