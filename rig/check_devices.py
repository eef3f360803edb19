"""Looking at one device of a rig without moving it: a servo, an array, or the loop over all servos.

Between the drivers and `checking`. Torque stays as it is found, and nothing is written to EEPROM.
"""

from collections.abc import Sequence

import numpy as np

from palpate.config import AnyFinger
from palpate.config.check_result import ArrayCheckOut, LoopOut, ServoCheckOut, SettingOut
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import RETURN_DELAY_UNIT_S
from palpate.drivers.dynamixel.failures import PortFailed
from palpate.drivers.dynamixel.health import Health, read_health
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.dynamixel.state import ServoState, StateReader
from palpate.drivers.tactile.frames import ArrayDriver, TactileFrame
from palpate.drivers.transport.adapter import latency_timer_s
from palpate.drivers.transport.clock import Clock
from palpate.errors import DeviceError, InputError
from palpate.rig.array_of import array_of
from palpate.rig.hand import OpenPort
from palpate.rig.timer_words import timer_warnings
from palpate.rig.wanted import WantedServo

__all__ = ["LOOP_S", "check_array", "check_loop", "check_servo"]

LOOP_S = 1.0
"""How long servos are read over and over, and arrays listened to."""

_WARM_C = 10  # below the limit
_POLL_S = 0.02
_RATE_SHARE = 0.95  # of the wanted rate that must arrive


def check_servo(bus: Bus, wanted: WantedServo) -> ServoCheckOut:
    """Look at one servo; it counts as answering if it does, as the model that the rig file says.

    Raises PortFailed if the port itself fails.
    """
    servo = wanted.servo
    blank = ServoCheckOut(id=servo.dxl_id, owner=wanted.owner, model=servo.model.name, answers=False)
    try:
        told = servo.check()
        eeprom = wanted.eeprom()
        health = read_health(bus, servo, eeprom)
    except PortFailed:
        raise
    except (DeviceError, InputError) as error:
        return blank.model_copy(update={"problems": (str(error),)})
    settings = tuple(
        SettingOut(item=name, found=health.settings[name], wanted=value)
        for name, value in eeprom.items()
        if health.settings[name] != value
    )
    low, high = health.voltage_limits_v
    return ServoCheckOut(
        id=servo.dxl_id,
        owner=wanted.owner,
        model=servo.model.name,
        answers=True,
        firmware=told.firmware,
        voltage_v=health.voltage_v,
        voltage_limits_v=(low, high),
        temperature_c=health.temperature_c,
        temperature_limit_c=health.temperature_limit_c,
        hardware_error=tuple(_words(str(flag.name)) for flag in health.hardware_error),
        torque_on=health.torque_on,
        return_delay_us=round(health.settings["Return Delay Time"] * RETURN_DELAY_UNIT_S * 1e6),
        settings=settings,
        problems=tuple(_servo_problems(health)),
        warnings=tuple(_servo_warnings(health, settings)),
    )


def check_array(spec: AnyFinger, wanted_hz: float, clock: Clock, open_port: OpenPort) -> ArrayCheckOut:
    """Let one array stream for a while, and count what arrives."""
    timer = latency_timer_s(spec.array.port)
    timer_ms = None if timer is None else timer * 1e3
    blank = ArrayCheckOut(
        finger=spec.name,
        port=spec.array.port,
        answers=False,
        wanted_hz=wanted_hz,
        latency_timer_ms=timer_ms,
        warnings=tuple(timer_warnings(spec.array.port, timer)),
    )
    try:
        port = open_port(spec.array.port, spec.array.baudrate_bps)
    except DeviceError as error:
        return blank.model_copy(update={"problems": (str(error),)})
    array = array_of(spec, port, clock)
    try:
        told = array.connect()
        found = blank.model_copy(
            update={
                "answers": True,
                "firmware": told.firmware,
                "emulated": told.emulated,
                "rows": told.rows,
                "columns": told.cols,
            }
        )
        try:
            array.start(wanted_hz)
            frames = _listen(array, clock)
        finally:
            array.stop()
    except DeviceError as error:
        return blank.model_copy(update={"problems": (str(error),)})
    finally:
        port.close()
    rate = _rate_hz(frames)
    problems = () if frames else ("it sends no frames; power it off and on, then check its firmware",)
    slow = bool(frames) and rate < _RATE_SHARE * wanted_hz
    warning = (f"{rate:.0f} frames arrive in a second instead of {wanted_hz:g}; check its cable and port",)
    return found.model_copy(
        update={
            "rate_hz": rate,
            "lost": array.counters.lost,
            "problems": problems,
            "warnings": blank.warnings + (warning if slow else ()),
        }
    )


def check_loop(
    bus: Bus, clock: Clock, servos: Sequence[Servo], baudrate: int, return_delays_s: Sequence[float]
) -> tuple[LoopOut, dict[int, ServoState]]:
    """Read the state of all servos for a second, as a run does; also the last state of each.

    Raises what the bus raises, for instance of servos without enough indirect addresses.
    """
    reader = StateReader(bus, servos)
    reader.arrange()
    begin = before = clock.now()
    times_s: list[float] = []
    states: dict[int, ServoState] = {}
    while before - begin < LOOP_S:
        states.update(reader.read(servos).found)
        now = clock.now()
        times_s.append(now - before)
        before = now
    loop = LoopOut(
        servos=len(servos),
        cycles=len(times_s),
        fast=reader.is_fast,
        rate_hz=len(times_s) / (before - begin),
        median_ms=float(np.median(times_s)) * 1e3,
        p99_ms=float(np.quantile(times_s, 0.99)) * 1e3,
        wire_ms=reader.wire_time_s(baudrate, return_delays_s) * 1e3,
    )
    return loop, states


def _listen(array: ArrayDriver, clock: Clock) -> list[TactileFrame]:
    frames: list[TactileFrame] = []
    end = clock.now() + LOOP_S
    while clock.now() < end:
        clock.sleep(_POLL_S)
        frames += array.frames()
    return frames


def _rate_hz(frames: Sequence[TactileFrame]) -> float:
    if len(frames) < 2:
        return 0.0
    span_s = frames[-1].device_time_s - frames[0].device_time_s
    return (len(frames) - 1) / span_s if span_s > 0 else 0.0


def _servo_problems(health: Health) -> list[str]:
    problems = []
    if health.hardware_error:
        causes = " and ".join(_words(str(flag.name)) for flag in health.hardware_error)
        problems.append(f"it reports a hardware error ({causes}); remove the cause, then reboot the servo")
    low, high = health.voltage_limits_v
    if not low <= health.voltage_v <= high:
        problems.append(
            f"its supply is {health.voltage_v:.1f} V, outside {low:.1f} … {high:.1f} V; check the supply"
        )
    if health.temperature_c >= health.temperature_limit_c:
        problems.append(
            f"it is at {health.temperature_c} °C, its limit {health.temperature_limit_c} °C; let it cool down"
        )
    if health.torque_on:
        problems.append("its torque is on, and nothing should hold it now; `palpate stop` switches it off")
    return problems


def _servo_warnings(health: Health, settings: Sequence[SettingOut]) -> list[str]:
    warnings = []
    if settings:
        differing = ", ".join(f"{item.item} {item.found} → {item.wanted}" for item in settings)
        warnings.append(f"not set up yet: {differing}")
    if health.temperature_limit_c - _WARM_C <= health.temperature_c < health.temperature_limit_c:
        warnings.append(f"it is warm: {health.temperature_c} °C of {health.temperature_limit_c} °C")
    return warnings


def _words(name: str) -> str:
    return name.replace("_", " ").lower()
