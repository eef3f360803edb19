"""How a group of servos is, in one read: position, velocity, current, and everything that may be wrong.

Above `bus`, beside `servo`; the rig's loops read through it. What belongs together lies apart in the
control table, so each servo is set up once, by its indirect addresses, to show it in one block
(e-Manual, Indirect Address). These live in RAM. A servo that has restarted meanwhile shows an empty block,
which must not be taken for an angle: the block ends with Status Return Level, which is never 0 here.
"""

import math
import struct
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from palpate.base.errors import DeviceError, InputError
from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus, GroupRead
from palpate.drivers.dynamixel.control_table import HardwareError, Item
from palpate.drivers.dynamixel.errors import (
    HardwareAlert,
    NotConfirmed,
    Restarted,
    StatusError,
)
from palpate.drivers.dynamixel.models import Indirect, Model
from palpate.drivers.dynamixel.packet import StatusPacket
from palpate.drivers.dynamixel.pending import Block
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.dynamixel.timing import fast_read_time_s, group_read_time_s

__all__ = ["STATE_BYTES", "ServoState", "StateReader", "state_in"]

_SHOWN = (
    "Present Current",
    "Present Velocity",
    "Present Position",
    "Hardware Error Status",
    "Torque Enable",
    "Bus Watchdog",
    "Status Return Level",
)
_FINE = HardwareError(0)
_LAYOUT = struct.Struct("<hiiBBbB")
STATE_BYTES = _LAYOUT.size
"""Bytes of a state block."""


class ServoState(NamedTuple):
    """What a servo measured at one instant, and how it is."""

    position_rad: float
    velocity_rad_s: float
    current_a: float
    torque_on: bool = True
    watchdog_tripped: bool = False
    hardware_error: HardwareError = _FINE


class StateReader:
    """Reads the state of servos on one bus."""

    def __init__(self, bus: Bus, servos: Iterable[Servo]) -> None:
        """Nothing is sent yet: `arrange` does it."""
        self.bus = bus
        self._servos = {servo.dxl_id: servo for servo in servos}
        self._fast = False

    def arrange(self) -> None:
        """Tell every servo what to show, and read it back.

        Raises what the bus raises, and InputError for a model with too few indirect addresses.
        """
        for servo in self._servos.values():
            if servo.model.firmware is None:
                servo.check()
            item, addresses = _shown(servo)
            self.bus.write(servo.dxl_id, item, addresses)
            if self.bus.read(servo.dxl_id, item) != addresses:
                raise NotConfirmed([servo.dxl_id], self.bus.port_name, [item.name])
        self._fast = all(servo.model.answers_fast for servo in self._servos.values())

    @property
    def is_fast(self) -> bool:
        """Whether Fast Sync Read is used: all servos know it."""
        return self._fast

    def wire_time_s(self, baudrate: int, return_delays_s: Sequence[float]) -> float:
        """Time on the wire of one `read`, with a return delay for each servo, without any latency."""
        sizes = [_LAYOUT.size] * len(return_delays_s)
        if self._fast:
            return fast_read_time_s(sizes, baudrate) + max(return_delays_s, default=0.0)
        return group_read_time_s(sizes, baudrate) + sum(return_delays_s)

    def read(self, servos: Sequence[Servo]) -> GroupRead[ServoState]:
        """The state of some of the servos at one instant; with Fast Sync Read where all of them know it."""
        blocks: dict[int, Block] = {servo.dxl_id: (_place(servo).data, _LAYOUT.size) for servo in servos}
        answers = self.bus.read_blocks(blocks, fast=self._fast)
        values: dict[int, ServoState] = {}
        errors: dict[int, DeviceError] = {}
        for dxl_id, answer in answers.items():
            state = self._state(self._servos[dxl_id], answer)
            if isinstance(state, DeviceError):
                errors[dxl_id] = state
                continue
            values[dxl_id] = state
            if state.hardware_error:
                errors[dxl_id] = HardwareAlert(
                    dxl_id, self.bus.port_name, state.hardware_error, carried_out=True
                )
        return GroupRead(values, errors)

    def _state(self, servo: Servo, answer: StatusPacket | DeviceError) -> ServoState | DeviceError:
        if isinstance(answer, DeviceError):
            return answer
        if answer.error_number:
            return StatusError(servo.dxl_id, self.bus.port_name, answer.error_number, "to read its state")
        return state_in(servo.model, answer.params, servo.turns) or Restarted(
            servo.dxl_id, self.bus.port_name
        )


def state_in(model: Model, block: bytes, turns: int = 0) -> ServoState | None:
    """The state in a block of `STATE_BYTES` bytes; None if the servo has restarted, or for another size.

    `turns`: how many the servo counts ahead, see `Servo.turns`.
    """
    if len(block) != STATE_BYTES:
        return None
    current, velocity, position, error, torque, watchdog, level = _LAYOUT.unpack(block)
    if level != ct.ANSWERS_ALL:
        return None
    unit = math.nan if model.torque is None else model.torque.current_unit_a
    return ServoState(
        (position - model.zero_tick) * model.rad_per_tick - 2 * math.pi * turns,
        velocity * model.velocity_unit_rad_s,
        current * unit,
        bool(torque),
        watchdog < 0,
        HardwareError(error) if error else _FINE,
    )


def _shown(servo: Servo) -> tuple[Item, int]:
    """All indirect addresses of the block as one item, and its value: two bytes for each byte shown."""
    first = _place(servo).address
    items = [servo.item(name) for name in _SHOWN]
    addresses = [item.address + part for item in items for part in range(item.size)]
    whole = Item(f"Indirect Address 1 to {len(addresses)}", first, 2 * len(addresses))
    return whole, int.from_bytes(b"".join(address.to_bytes(2, "little") for address in addresses), "little")


def _place(servo: Servo) -> Indirect:
    place = servo.model.indirect
    if place is None or place.count < _LAYOUT.size:
        raise InputError(
            f"a {servo.model.name} has too few indirect addresses to show its state in one block"
        )
    return place
