"""What an emulated servo protects itself from: overload, overheating, a supply out of its limits.

`servo_unit` lets it watch every step and latches what it reports in Hardware Error Status. The e-Manual says
which limits there are ("Shutdown", "Temperature Limit", "Min/Max Voltage Limit"); how long an overload lasts
and how a servo warms up it does not say. Those are guesses.
"""

from collections.abc import Sequence
from itertools import chain, repeat

from palpate.drivers.dynamixel.specifications import ServoSpecification
from palpate.drivers.emulators.servo_table import ControlTable

__all__ = [
    "ELECTRICAL_SHOCK_BIT",
    "ENCODER_BIT",
    "INPUT_VOLTAGE_BIT",
    "OVERHEATING_BIT",
    "OVERLOAD_BIT",
    "Protection",
    "repeated_sum",
]

# bits of Hardware Error Status and Shutdown
INPUT_VOLTAGE_BIT = 0x01
OVERHEATING_BIT = 0x04
ENCODER_BIT = 0x08
ELECTRICAL_SHOCK_BIT = 0x10
OVERLOAD_BIT = 0x20

# The manual calls overload "persistent load that exceeds maximum output" and gives no numbers.
_OVERLOAD_FRACTION = 0.8  # of the stall current
_OVERLOAD_S = 1.0
_LOOK_S = 0.1  # temperature and voltage are looked at this often

# One lump that copper losses warm and air cools: 100 K above the air with the stall current for ever.
_AIR_C = 30.0
_STALL_RISE_K = 100.0
_COOLING_S = 120.0


class Protection:
    """Watches current, temperature and supply. `temperature_c` and `supply_v` may be set from outside."""

    def __init__(self, model: ServoSpecification, table: ControlTable) -> None:
        self.temperature_c = _AIR_C
        self.supply_v = model.nominal_v
        self._table = table
        self._stall_a = model.motor.stall_current_a
        self._overload_a = _OVERLOAD_FRACTION * self._stall_a
        self._overloaded_s = 0.0
        self._since_look_s = 0.0
        self._charge = 0.0  # A²·s since the last look

    def forget_overload(self) -> None:
        """Begin anew to count how long an overload lasts."""
        self._overloaded_s = 0.0

    def watch(self, dt_s: float, current_a: float, *, driven: bool) -> int:
        """Let `dt_s` pass at a motor current; the bits of Hardware Error Status that it sets."""
        bits = 0
        if driven:
            self._charge += current_a * current_a * dt_s
            if current_a >= self._overload_a or current_a <= -self._overload_a:
                self._overloaded_s += dt_s
                if self._overloaded_s >= _OVERLOAD_S:
                    self._overloaded_s = 0.0
                    bits = OVERLOAD_BIT
            else:
                self._overloaded_s = 0.0
        self._since_look_s += dt_s
        if self._since_look_s >= _LOOK_S:
            bits |= self._look()
        return bits

    def quiet_steps(self, dt_s: float, *, driven: bool) -> int:
        """How many steps of `dt_s` `watch_all` may take at once: only the last of them can set a bit."""
        left_s = _LOOK_S - self._since_look_s
        if driven:
            left_s = min(left_s, _OVERLOAD_S - self._overloaded_s)
        return max(int(left_s / dt_s), 1)

    def watch_all(
        self, dt_s: float, steps: int, currents: Sequence[float], last_a: float, *, driven: bool
    ) -> int:
        """So many times `watch`, within `quiet_steps`: at `currents` (A), and at `last_a` after them."""
        bits = 0
        if driven:
            charge, overloaded_s, most_a = self._charge, 0.0, self._overload_a
            for current_a in currents:
                charge += current_a * current_a * dt_s
            self._charge = repeated_sum(charge, last_a * last_a * dt_s, steps - len(currents))
            if abs(last_a) >= most_a or max(map(abs, currents), default=0.0) >= most_a:
                overloaded_s = self._overloaded_s
                for current_a in chain(currents, repeat(last_a, steps - len(currents))):
                    overloaded_s = overloaded_s + dt_s if abs(current_a) >= most_a else 0.0
            if overloaded_s >= _OVERLOAD_S:
                overloaded_s, bits = 0.0, OVERLOAD_BIT
            self._overloaded_s = overloaded_s
        self._since_look_s = repeated_sum(self._since_look_s, dt_s, steps)
        if self._since_look_s >= _LOOK_S:
            bits |= self._look()
        return bits

    def _look(self) -> int:
        load = self._charge / self._since_look_s / self._stall_a**2
        rise = _STALL_RISE_K * load - (self.temperature_c - _AIR_C)
        self.temperature_c += rise * self._since_look_s / _COOLING_S
        self._since_look_s = self._charge = 0.0
        table = self._table
        bits = OVERHEATING_BIT if round(self.temperature_c) > table.get("Temperature Limit") else 0
        low, high = table.get("Min Voltage Limit"), table.get("Max Voltage Limit")
        return bits | (0 if low <= round(10 * self.supply_v) <= high else INPUT_VOLTAGE_BIT)


def repeated_sum(value: float, step: float, times: int) -> float:
    """`value` after so many steps, rounded at each of them."""
    for _ in range(times):
        value += step
    return value
