"""A servo in rad, rad/s and A. Above the bus, below finger kinematics and the rig.

Zero is tick 2048, in extended modes of the turn in which the servo was powered up: after power-up, a reboot
or a change of mode, a servo knows its angle within one turn only. Positive is the servo's own direction,
counter-clockwise seen from the horn. Angles are rounded to the nearest tick and never clamped.
"""

import contextlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus, Ping
from palpate.drivers.dynamixel.control_table import Item, OperatingMode, model_named
from palpate.drivers.dynamixel.failures import HardwareAlert
from palpate.errors import DeviceError, SafetyStop

__all__ = ["Servo", "ServoState", "read_states", "stop_at", "torque_off_all", "write_goals"]


@dataclass(frozen=True, slots=True)
class ServoState:
    """What a servo measured at one instant."""

    position_rad: float
    velocity_rad_s: float
    current_a: float


class Servo:
    """One servo on a bus."""

    def __init__(
        self,
        bus: Bus,
        dxl_id: int,
        model: str = "XM430-W350",
        *,
        range_rad: tuple[float, float] = (-math.pi, math.pi - ct.RAD_PER_TICK),
    ) -> None:
        """`range_rad`: the angles (lowest, highest) that may be commanded.

        The default is the turn of Position Control Mode. Raises InputError for an unknown model.
        """
        self.dxl_id = dxl_id
        self.model = model_named(model)
        self.range_rad = range_rad
        self._bus = bus

    def check(self) -> Ping:
        """Ping; raises NotAnswering, or DeviceError if the servo is of another model."""
        answer = self._bus.ping(self.dxl_id)
        if answer.model_number != self.model.number:
            names = {model.number: model.name for model in ct.MODELS}
            found = names.get(answer.model_number, "unknown model")
            raise DeviceError(
                f"servo {self.dxl_id} on {self._bus.port_name} answers as {found} (model number "
                f"{answer.model_number}), not {self.model.name}; check ids and `model` in the rig file"
            )
        return answer

    def prepare(
        self, mode: OperatingMode, current_limit_a: float, velocity_limit_rad_s: float | None = None
    ) -> None:
        """Torque off, then EEPROM as this stack needs it, read back; items that are right are not written.

        Sets Operating Mode, Current Limit and Velocity Limit (rounded down; None leaves it), Drive Mode 0
        (normal direction, velocity-based profile) and Return Delay Time 0.
        Raises ValueError for limits that the model cannot keep, DeviceError if an item does not stay written.
        """
        wanted: dict[Item, int] = {
            ct.RETURN_DELAY_TIME: 0,
            ct.DRIVE_MODE: 0,
            ct.OPERATING_MODE: int(mode),
            ct.CURRENT_LIMIT: self._current_units(current_limit_a, self.model.largest_current),
        }
        if velocity_limit_rad_s is not None:
            wanted[ct.VELOCITY_LIMIT] = _units_down(
                velocity_limit_rad_s, ct.VELOCITY_UNIT_RAD_S, "velocity limit"
            )
        self.torque(on=False)
        for item, value in wanted.items():
            if self._bus.read(self.dxl_id, item) == value:
                continue
            self._bus.write(self.dxl_id, item, value)
            found = self._bus.read(self.dxl_id, item)
            if found != value:
                raise DeviceError(
                    f"servo {self.dxl_id} on {self._bus.port_name} keeps {item.name} at {found} instead of "
                    f"{value}; check its firmware"
                )

    def set_profile(self, velocity_rad_s: float, acceleration_rad_s2: float) -> None:
        """Set the trapezoid of the next moves, rounded down to the servo's units (0.024 rad/s, 0.37 rad/s²).

        Raises ValueError for values that would round to 0, which the servo takes for "unlimited".
        """
        velocity = _units_down(velocity_rad_s, ct.VELOCITY_UNIT_RAD_S, "profile velocity")
        acceleration = _units_down(acceleration_rad_s2, ct.ACCELERATION_UNIT_RAD_S2, "profile acceleration")
        self._bus.write(self.dxl_id, ct.PROFILE_ACCELERATION, acceleration)
        self._bus.write(self.dxl_id, ct.PROFILE_VELOCITY, velocity)

    def no_profile(self) -> None:
        """Follow every goal at once, as streamed goals need it."""
        self._bus.write(self.dxl_id, ct.PROFILE_ACCELERATION, 0)
        self._bus.write(self.dxl_id, ct.PROFILE_VELOCITY, 0)

    def torque(self, *, on: bool) -> None:
        """Switch torque on or off."""
        self._bus.write(self.dxl_id, ct.TORQUE_ENABLE, int(on))

    def set_goal_current_a(self, current_a: float) -> None:
        """Set the largest current of Current-based Position Control Mode, rounded down to the servo's unit.

        Raises ValueError if negative or above the model's largest; the servo refuses more than Current Limit.
        """
        self._bus.write(
            self.dxl_id, ct.GOAL_CURRENT, self._current_units(current_a, self.model.largest_current)
        )

    def set_goal_rad(self, goal_rad: float) -> None:
        """Move to an angle. Raises SafetyStop outside `range_rad`, and sends nothing then."""
        self._bus.write(self.dxl_id, ct.GOAL_POSITION, self.goal_ticks(goal_rad))

    def goal_ticks(self, goal_rad: float) -> int:
        """Goal Position for an angle in `range_rad`; SafetyStop outside it."""
        low, high = self.range_rad
        if not low <= goal_rad <= high:
            raise SafetyStop(
                f"servo {self.dxl_id} on {self._bus.port_name} was to go to {goal_rad:.4f} rad, outside "
                f"its range {low:.4f} … {high:.4f} rad; nothing was sent: "
                "check the plan or the range in the rig file"
            )
        return round(goal_rad / ct.RAD_PER_TICK) + ct.ZERO_TICK

    def arm_watchdog(self, timeout_s: float) -> None:
        """Let the servo stop by itself if it hears nothing for `timeout_s`.

        0.02 … 2.54 s, rounded up to 20 ms; ValueError beyond.

        While it is tripped the servo refuses goals with Data Range Error; `disarm_watchdog` clears it.
        """
        units = math.ceil(timeout_s / ct.WATCHDOG_UNIT_S - 1e-9)
        if not 1 <= units <= 127:
            raise ValueError(f"Bus Watchdog takes 0.02 … 2.54 s, not {timeout_s} s")
        self._bus.write(self.dxl_id, ct.BUS_WATCHDOG, units)

    def disarm_watchdog(self) -> None:
        """Switch Bus Watchdog off, and clear it if it has tripped."""
        self._bus.write(self.dxl_id, ct.BUS_WATCHDOG, 0)

    def watchdog_tripped(self) -> bool:
        """True if the servo has stopped because it heard nothing for too long."""
        return self._bus.read(self.dxl_id, ct.BUS_WATCHDOG) < 0

    def state_of(self, items: Mapping[Item, int]) -> ServoState:
        """Convert the items Present Current, Velocity and Position."""
        return ServoState(
            (items[ct.PRESENT_POSITION] - ct.ZERO_TICK) * ct.RAD_PER_TICK,
            items[ct.PRESENT_VELOCITY] * ct.VELOCITY_UNIT_RAD_S,
            items[ct.PRESENT_CURRENT] * self.model.current_unit_a,
        )

    def _current_units(self, current_a: float, largest: int) -> int:
        if not 0 <= current_a <= largest * self.model.current_unit_a * (1 + 1e-9):
            raise ValueError(
                f"a current of {current_a} A is outside 0 … {largest * self.model.current_unit_a:.3f} A "
                f"of a {self.model.name} (servo {self.dxl_id})"
            )
        return min(largest, int(current_a / self.model.current_unit_a + 1e-6))


def read_states(bus: Bus, servos: Sequence[Servo]) -> dict[int, ServoState]:
    """State of several servos by id, from one sync read. Raises what `Bus.sync_read` raises."""
    block = bus.sync_read([servo.dxl_id for servo in servos], ct.PRESENT_CURRENT, ct.PRESENT_POSITION)
    return {servo.dxl_id: servo.state_of(block[servo.dxl_id]) for servo in servos}


def write_goals(bus: Bus, goals_rad: Mapping[Servo, float]) -> None:
    """Move several servos in one sync write, which servos do not confirm.

    Raises SafetyStop if any goal is outside its servo's range; nothing is sent then.
    """
    bus.sync_write(
        ct.GOAL_POSITION, {servo.dxl_id: servo.goal_ticks(rad) for servo, rad in goals_rad.items()}
    )


def stop_at(bus: Bus, goals_rad: Mapping[Servo, float]) -> None:
    """Stop several servos at once at the given angles, without a profile, so that none slows down first.

    The profile must be set again before the next move. Raises SafetyStop as `write_goals` does.
    """
    bus.sync_write(ct.PROFILE_VELOCITY, {servo.dxl_id: 0 for servo in goals_rad})
    write_goals(bus, goals_rad)


def torque_off_all(bus: Bus, servos: Iterable[Servo]) -> list[DeviceError]:
    """Switch torque off on every servo, each by itself whatever happens to the others.

    All are told at once first; then each is asked to confirm, and one that does not is told again. Returns
    one error for every servo whose torque may still be on. A servo that confirms while it reports a hardware
    error is off, and is not listed.
    """
    servos = list(servos)
    with contextlib.suppress(DeviceError):  # a port that fails here is reported by what follows
        bus.sync_write(ct.TORQUE_ENABLE, {servo.dxl_id: 0 for servo in servos})
    doubtful = [servo for servo in servos if _torque_off(bus, servo) is not None]
    return [error for servo in doubtful if (error := _torque_off(bus, servo)) is not None]


def _torque_off(bus: Bus, servo: Servo) -> DeviceError | None:
    """What went wrong if torque may still be on."""
    try:
        bus.write(servo.dxl_id, ct.TORQUE_ENABLE, 0)
    except HardwareAlert as alert:
        return None if alert.carried_out else alert
    except DeviceError as error:
        return error
    return None


def _units_down(value: float, unit: float, what: str) -> int:
    units = int(value / unit + 1e-6) if math.isfinite(value) else 0
    if not 1 <= units <= 32767:
        raise ValueError(f"{what} {value} is outside {unit:.4f} … {32767 * unit:.1f}")
    return units
