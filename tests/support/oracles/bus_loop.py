"""The loop of a rig over the bus."""

from dataclasses import dataclass

from serial.serialutil import SerialBase

from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import BAUD_RATES
from palpate.drivers.dynamixel.exchanges import sync_write_time_s
from palpate.drivers.dynamixel.servo import Servo, write_goals
from palpate.drivers.dynamixel.servo_state import StateReader
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.transport.clock import Clock

# ----------------------------------------------------------------------------------------------------
# A control loop over servos on one bus: read all, write all.
#
# For the benchmark of the loop's cost and the test of its time on the wire. The servos' shafts stand still,
# so that emulation costs little; what goes over the wire is the same.

GOALS_RAD = (-0.3, 0.1, 0.2, -0.1)  # one after another, so that no two writes in a row are the same


@dataclass(frozen=True, slots=True)
class LoopCase:
    """Servos of one model on a bus."""

    servos: int
    model: str
    firmware: int
    baudrate: int

    @property
    def ids(self) -> range:
        return range(1, self.servos + 1)

    def chain(self) -> ServoChain:
        """The emulated servos, each at another angle."""
        code = BAUD_RATES.index(self.baudrate)
        servos = [
            EmulatedServo(k, model=self.model, firmware=self.firmware, start_rad=0.1 * k, baud_rate_code=code)
            for k in self.ids
        ]
        return ServoChain(servos, lambda _: None, baudrate=self.baudrate)


CASES = tuple(
    LoopCase(count, model, firmware, baudrate)
    for model, firmware in (("XM430-W350", 44), ("XM430-W350", 45), ("XL330-M288", 52))
    for count in (3, 6)
    for baudrate in (1_000_000, 4_000_000)
)


class BusLoop:
    """Palpate's loop: the state of all servos in one read, all goals in one write."""

    def __init__(self, case: LoopCase, port: SerialBase, clock: Clock, latency_s: float = 1e-3) -> None:
        """Set the servos up for it: no return delay, and the state shown in one block."""
        self.bus = Bus(port, clock, case.baudrate, latency_s=latency_s)
        self.servos = [Servo(self.bus, dxl_id, case.model) for dxl_id in case.ids]
        for servo in self.servos:
            servo.ensure("Return Delay Time", 0)
        self.reader = StateReader(self.bus, self.servos)
        self.reader.arrange()
        self._case = case

    @property
    def wire_s(self) -> float:
        """Time of a cycle by the formulas for the wire."""
        reading = self.reader.wire_time_s(self._case.baudrate, [0.0] * self._case.servos)
        return reading + sync_write_time_s(self._case.servos, 4, self._case.baudrate)

    def cycle(self, number: int) -> None:
        states = self.reader.read(self.servos)
        assert not states.errors, states.errors
        goal = GOALS_RAD[number % len(GOALS_RAD)]
        write_goals(self.bus, dict.fromkeys(self.servos, goal))
