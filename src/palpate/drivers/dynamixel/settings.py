"""Settings that a servo brings from an earlier life: who owns each item that can be written.

A run writes RAM, and of EEPROM what the rig file determines, whenever it prepares a rig. The rest of EEPROM
it leaves as it is: such a value may be somebody's intention. It is compared with how the model is made, or
with what the rig file records, and a person decides: `palpate setup-motors` shows it, asks, and writes it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import GAINS, HardwareError
from palpate.drivers.dynamixel.errors import HardwareAlert, ServoError
from palpate.drivers.dynamixel.servo import Servo, read_items

HOMING_OFFSET, SECONDARY_ID, SHUTDOWN = "Homing Offset", "Secondary(Shadow) ID", "Shutdown"
LARGEST_HOMING_OFFSET = 1024
"""Largest Homing Offset (steps) that counts in Position Control Mode, either way."""

_NO_SECONDARY_ID = 253  # ids from here on mean none


class Owner(Enum):
    """Owner of an item: who decides what it holds."""

    RUN = "a run writes it"
    PERSON = "a run compares it; palpate setup-motors writes it"
    NOBODY = "nothing that palpate does depends on it"


@dataclass(frozen=True, slots=True)
class Setting:
    """Owner of an item, and what a value that is not the expected one does.

    `floor`: a greater value does no harm. `limits`: bits of Hardware Error Status for which it is the limit.
    """

    owner: Owner
    effect: str = ""
    floor: bool = False
    limits: int = 0


_RUN, _NOBODY = Setting(Owner.RUN), Setting(Owner.NOBODY)
_VOLTAGE = Setting(
    Owner.PERSON,
    "it takes another supply for a fault than its model does",
    limits=HardwareError.INPUT_VOLTAGE,
)

SETTINGS: Mapping[str, Setting] = {
    **dict.fromkeys(("ID", "Baud Rate", "Return Delay Time", "Operating Mode", "Current Limit"), _RUN),
    **dict.fromkeys(("Max Position Limit", "Min Position Limit"), _RUN),
    "Drive Mode": _RUN,  # bits: reversed direction, time-based profile, torque on by a goal
    "Startup Configuration": _RUN,  # bits: torque on at power-up, RAM from a backup
    "Velocity Limit": Setting(Owner.RUN, "it is slower than the rig file says", floor=True),
    SECONDARY_ID: Setting(Owner.PERSON, "it does silently what another servo is told to do"),
    "Protocol Type": Setting(Owner.PERSON, "it speaks Protocol 2.0 only until it hears another one"),
    HOMING_OFFSET: Setting(Owner.PERSON, "zeros in the rig file do not hold for it"),
    "Temperature Limit": Setting(
        Owner.PERSON,
        "it takes another temperature for too hot than its model does",
        limits=HardwareError.OVERHEATING,
    ),
    "Max Voltage Limit": _VOLTAGE,
    "Min Voltage Limit": _VOLTAGE,
    "PWM Limit": Setting(Owner.PERSON, "it is weaker and slower than its model", floor=True),
    "PWM Slope": Setting(Owner.PERSON, "its motor follows the position loop more slowly", floor=True),
    SHUTDOWN: Setting(Owner.PERSON, "it stays on when overloaded or too hot"),
    "Moving Threshold": _NOBODY,
    "LED": _NOBODY,
    **dict.fromkeys(("Torque Enable", "Status Return Level", "Bus Watchdog", *GAINS), _RUN),
    **dict.fromkeys(("Goal PWM", "Goal Current", "Goal Velocity", "Goal Position"), _RUN),
    **dict.fromkeys(("Profile Acceleration", "Profile Velocity"), _RUN),
}
"""Every item of the X series that can be written, but for indirect ones (a run's) and external ports."""


@dataclass(frozen=True, slots=True)
class ItemChange:
    """An item that is not as it should be."""

    item: str
    found: int
    wanted: int

    def __str__(self) -> str:
        return f"{self.item} is {self.found} instead of {self.wanted}"

    @property
    def effect(self) -> str:
        """What such a value does."""
        return SETTINGS[self.item].effect

    def remedy(self, dxl_id: int) -> str:
        """The command that mends it in a servo."""
        command = f"palpate setup-motors --rig FILE --id {dxl_id}, which writes {self.wanted}"
        if self.item != HOMING_OFFSET or abs(self.found) > LARGEST_HOMING_OFFSET:
            return command
        keep = f"write homing_offset = {self.found} into the rig file"
        return f"{command}; if its zero was measured with {self.found}, {keep}"


def items_to_compare(servo: Servo) -> dict[str, int]:
    """Items that a person owns, with the values that are expected; none for a model without a full table."""
    return {
        name: servo.homing_offset if name == HOMING_OFFSET else item.default
        for name, item in (servo.model.table or {}).items()
        if name in SETTINGS and SETTINGS[name].owner is Owner.PERSON
    }


def differences(found: Mapping[str, int], wanted: Mapping[str, int]) -> list[ItemChange]:
    """Items that are not as they are wanted; those that were not read are left out."""
    return [
        ItemChange(name, found[name], value)
        for name, value in wanted.items()
        if name in found and not _is_kept(name, found[name], value)
    ]


def _is_kept(name: str, found: int, wanted: int) -> bool:
    if name == SECONDARY_ID:
        return min(found, _NO_SECONDARY_ID) == min(wanted, _NO_SECONDARY_ID)
    if name == SHUTDOWN:
        return wanted & ~found == 0  # more protection does no harm
    return found == wanted or (name in SETTINGS and SETTINGS[name].floor and found > wanted)


def foreign_settings(bus: Bus, servo: Servo) -> list[ItemChange]:
    """Items that a person owns and that are not as expected. Raises what the bus raises."""
    wanted = items_to_compare(servo)
    return differences(read_items(bus, servo, wanted), wanted)


def refuse_foreign_settings(bus: Bus, servos: Sequence[Servo]) -> None:
    """Refuse what must not be moved with: another zero, a second id that is in use, a latched error.

    Raises ServoError with the command that mends it, HardwareAlert for an error, and what the bus raises.
    """
    ids = {servo.dxl_id for servo in servos}
    for servo in servos:
        wanted = items_to_compare(servo)
        found = read_items(bus, servo, [name for name in (HOMING_OFFSET, SECONDARY_ID) if name in wanted])
        for change in differences(found, wanted):
            if change.item == HOMING_OFFSET or change.found in ids:
                raise _refusal(bus, servo, change)
        error = bus.hardware_error(servo.dxl_id)
        if error:
            raise HardwareAlert(servo.dxl_id, bus.port_name, error, carried_out=True)


def _refusal(bus: Bus, servo: Servo, change: ItemChange) -> ServoError:
    words = f"servo {servo.dxl_id} on {bus.port_name}: its {change}: {change.effect}"
    return ServoError([servo.dxl_id], bus.port_name, f"{words}; {change.remedy(servo.dxl_id)}")
