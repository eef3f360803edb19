"""Torque off for every servo on a wire: broadcast to all, then confirmed by each.

A broadcast needs no answer, so it also works beside a program that is using the wire; its traffic may spoil a
packet, therefore an emergency stop repeats it. Confirming reads, and needs the wire for itself.
"""

import contextlib
from collections.abc import Iterable

from palpate.base.errors import DeviceError
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import TORQUE_ENABLE, Item
from palpate.drivers.dynamixel.errors import HardwareAlert, PortFailed
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.transport.clock import Clock

__all__ = ["broadcast_torque_off", "confirm_torque_off", "disable_torque"]

_PAUSE_S = 0.013  # no multiple of a usual loop's period, so that not every packet meets the same traffic
_ROUNDS = 4


def disable_torque(bus: Bus, servos: Iterable[Servo]) -> list[DeviceError]:
    """Switch torque off on every servo, each by itself whatever happens to the others.

    One broadcast to all servos on the wire comes first; then each is asked to confirm, and one that does not
    is written again, with the others in between. Returns one error for every servo whose torque may still be
    on. A servo that confirms while it reports a hardware error is off, and is not listed.
    """
    with contextlib.suppress(DeviceError):  # a port that fails here is reported by what follows
        bus.broadcast_torque_off()
    failed: dict[Servo, DeviceError | None] = dict.fromkeys(servos)
    for _ in range(_ROUNDS):
        tried = {servo: _write_off(bus, servo.dxl_id, servo.item("Torque Enable")) for servo in failed}
        failed = {servo: error for servo, error in tried.items() if error is not None}
    return [error for error in failed.values() if error is not None]


def broadcast_torque_off(bus: Bus, clock: Clock, times: int) -> None:
    """Broadcast torque off `times` times. Reads nothing. Raises PortFailed."""
    for _ in range(times):
        bus.broadcast_torque_off()
        clock.sleep(_PAUSE_S)


def confirm_torque_off(bus: Bus, dxl_ids: Iterable[int]) -> dict[int, DeviceError | None]:
    """Write Torque Enable 0 to every servo and read it back; by id None if torque is off, else why not.

    Each by itself, whatever happens to the others; one that does not answer is asked again last.
    """
    found = {dxl_id: _read_off(bus, dxl_id) for dxl_id in dxl_ids}
    for _ in range(_ROUNDS - 1):
        for dxl_id, problem in found.items():
            if problem is not None and not isinstance(problem, PortFailed):
                found[dxl_id] = _read_off(bus, dxl_id)
    return found


def _write_off(bus: Bus, dxl_id: int, item: Item) -> DeviceError | None:
    """What went wrong if torque may still be on."""
    try:
        bus.write(dxl_id, item, 0)
    except HardwareAlert as alert:
        return None if alert.carried_out else alert
    except DeviceError as error:
        return error
    return None


def _read_off(bus: Bus, dxl_id: int) -> DeviceError | None:
    """The same, confirmed by reading."""
    problem = _write_off(bus, dxl_id, TORQUE_ENABLE)
    if problem is not None:
        return problem
    try:
        on = bus.read(dxl_id, TORQUE_ENABLE, alert=False)
    except DeviceError as error:
        return error
    return DeviceError(f"servo {dxl_id} on {bus.port_name} says that its torque is on") if on else None
