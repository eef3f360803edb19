"""Causes of a servo's error that can still be read once torque is off: a restart, limits, its baud rate.

An error says what was noticed first, such as silence. Before the operator reads it, the servo is asked again.
"""

from collections.abc import Callable, Sequence

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError
from palpate.drivers.dynamixel import (
    BAUD_RATES,
    SETTINGS,
    Bus,
    HardwareAlert,
    NotAnswering,
    Restarted,
    Servo,
    ServoError,
    StateReader,
    foreign_settings,
    scan,
)
from palpate.drivers.transport import Clock, has_baudrate

_BOOT_S = 0.7  # a servo that is starting up answers again by then


def explain_servo_error(
    error: ServoError, reader: StateReader, servos: Sequence[Servo], clock: Clock
) -> bool:
    """Put a cause that is found in the place of an error's words; False if none is. Raises DeviceError."""
    for servo in servos:
        if servo.dxl_id not in error.dxl_ids:
            continue
        words = None
        if isinstance(error, HardwareAlert) and error.cause:
            words = _foreign_limit(error, reader.bus, servo)
        elif isinstance(error, NotAnswering):
            clock.sleep(_BOOT_S)
            found = reader.read([servo]).errors.get(servo.dxl_id)
            words = str(found) if isinstance(found, Restarted) else None
        if words is not None:
            error.args = (words,)
            return True
    return False


def _foreign_limit(alert: HardwareAlert, bus: Bus, servo: Servo) -> str | None:
    """Why a servo reports an error that its model would not report."""
    for change in foreign_settings(bus, servo):
        if alert.cause and SETTINGS[change.item].limits & alert.cause:
            return (
                f"servo {servo.dxl_id} on {bus.port_name} reports a hardware error, because its {change}: "
                f"{change.effect}; {change.remedy(servo.dxl_id)}; then palpate reboot --rig FILE --id "
                f"{servo.dxl_id}"
            )
    return None


def explain_silence(
    error: NotAnswering, open_port: Callable[[int], SerialBase], baudrate: int, clock: Clock, latency_s: float
) -> bool:
    """Look for a silent servo at other baud rates, on a port that is closed; False if it is at none."""
    rates = [rate for rate in BAUD_RATES if rate != baudrate] if has_baudrate(error.port) else []
    try:
        found = scan(open_port, clock, rates, error.dxl_ids, latency_s=latency_s).found
    except DeviceError:
        return False
    for item in found:
        error.args = (
            f"servo {item.dxl_id} on {error.port} answers at {item.baudrate} baud, not at the rig file's "
            f"{baudrate}; palpate setup-motors --rig FILE --id {item.dxl_id}",
        )
    return bool(found)


def weakness(bus: Bus, servo: Servo) -> str | None:
    """Setting that makes a servo weaker than its model, with what mends it; None if it has none."""
    for change in foreign_settings(bus, servo):
        if SETTINGS[change.item].floor:
            return f"its {change}: {change.effect}; {change.remedy(servo.dxl_id)}"
    return None
