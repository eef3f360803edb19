"""Check of servos without moving them: one servo, or the read loop over all.

Torque stays as it is found, and nothing is written to EEPROM.
"""

from collections.abc import Sequence

import numpy as np

from palpate.base.errors import DeviceError, InputError
from palpate.config.check_result import LoopOut, ServoCheckOut, SettingOut
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import RETURN_DELAY_UNIT_S
from palpate.drivers.dynamixel.errors import PortFailed
from palpate.drivers.dynamixel.health import Health, read_health
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.dynamixel.state import ServoState, StateReader
from palpate.drivers.transport.clock import Clock
from palpate.rig.servo_settings import ServoSettings

__all__ = ["LOOP_S", "check_loop", "check_servo", "rate_in_run_hz"]

LOOP_S = 1.0
"""How long servos are read over and over."""

_WARM_C = 10  # below the limit


def check_servo(bus: Bus, wanted: ServoSettings) -> ServoCheckOut:
    """Look at one servo; it counts as answering if it does, as the model that the rig file says.

    Raises PortFailed if the port itself fails.
    """
    servo = wanted.servo
    blank = ServoCheckOut(id=servo.dxl_id, owner=wanted.owner, model=servo.model.name, answers=False)
    try:
        reply = servo.check()
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
    return ServoCheckOut.of(
        health,
        id=servo.dxl_id,
        owner=wanted.owner,
        model=servo.model.name,
        answers=True,
        firmware=reply.firmware,
        hardware_error=tuple(_words(str(flag.name)) for flag in health.hardware_error),
        return_delay_us=round(health.settings["Return Delay Time"] * RETURN_DELAY_UNIT_S * 1e6),
        settings=settings,
        problems=tuple(_servo_problems(health)),
        warnings=tuple(_servo_warnings(health, settings)),
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
        states.update(reader.read(servos).values)
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


def rate_in_run_hz(loop: LoopOut, return_delays_s: Sequence[float]) -> float:
    """How often a run can read all servos: it sets their Return Delay Times, which took part here, to 0."""
    delay_s = max(return_delays_s, default=0.0) if loop.fast else sum(return_delays_s)
    return 1 / max(1 / loop.rate_hz - delay_s, 1e-6)


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
