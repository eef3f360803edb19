"""Torque off for every servo on a wire, at once and then surely. Above `bus`, below the emergency verb.

Telling all needs no answer, so it also works beside a program that is using the wire; its traffic may spoil a
packet, therefore it is told many times. Confirming reads, and needs the wire for itself.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import TORQUE_ENABLE
from palpate.drivers.dynamixel.failures import HardwareAlert, PortFailed
from palpate.drivers.transport.clock import Clock
from palpate.errors import DeviceError

__all__ = ["Confirmation", "confirm_off", "tell_all_off"]

_PAUSE_S = 0.013  # no multiple of a usual loop's period, so that not every packet meets the same traffic
_ROUNDS = 4


@dataclass(frozen=True, slots=True)
class Confirmation:
    """Whether a servo has confirmed that torque is off, and if not, why not."""

    dxl_id: int
    problem: DeviceError | None

    @property
    def is_off(self) -> bool:
        """Whether it is certain."""
        return self.problem is None


def tell_all_off(bus: Bus, clock: Clock, times: int) -> None:
    """Tell everybody on the wire to switch torque off, `times` times. Reads nothing. Raises PortFailed."""
    for _ in range(times):
        bus.torque_off_everywhere()
        clock.sleep(_PAUSE_S)


def confirm_off(bus: Bus, dxl_ids: Iterable[int]) -> list[Confirmation]:
    """Ask every servo for Torque Enable until it is 0, and write that again where it is not.

    Each by itself, whatever happens to the others; one that does not answer is asked again last.
    """
    found = {dxl_id: _off(bus, dxl_id) for dxl_id in dxl_ids}
    for _ in range(_ROUNDS - 1):
        for dxl_id, problem in found.items():
            if problem is not None and not isinstance(problem, PortFailed):
                found[dxl_id] = _off(bus, dxl_id)
    return [Confirmation(dxl_id, problem) for dxl_id, problem in found.items()]


def _off(bus: Bus, dxl_id: int) -> DeviceError | None:
    """What went wrong if torque may still be on."""
    try:
        try:
            bus.write(dxl_id, TORQUE_ENABLE, 0)
        except HardwareAlert as alert:
            if not alert.carried_out:
                return alert
        if bus.read_alerting(dxl_id, TORQUE_ENABLE) != 0:
            return DeviceError(f"servo {dxl_id} on {bus.port_name} says that its torque is on")
    except DeviceError as error:
        return error
    return None
