"""The host stack on emulated servos over a mock wire: units, blocks of items, and errors that name who."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest
import serial

from palpate.base.errors import DeviceError, SafetyStop
from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus, Ping
from palpate.drivers.dynamixel.control_table import HardwareError, Item, OperatingMode
from palpate.drivers.dynamixel.errors import (
    DamagedAnswer,
    HardwareAlert,
    NotAnswering,
    PortFailed,
    StatusError,
)
from palpate.drivers.dynamixel.exchanges import group_read_time_s
from palpate.drivers.dynamixel.packet import StatusErrorCode, StatusPacket, encode_status
from palpate.drivers.dynamixel.servo import Servo, disable_torque, write_goals
from palpate.drivers.dynamixel.servo_state import ServoState, StateReader
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.emulators.servo_firmware import OVERLOAD_BIT
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.drivers.transport.recording import Direction
from palpate.drivers.transport.wire import Device, Emission
from support.devices.ports import Listener
from support.devices.simple import Passing

BAUD = 1_000_000
STEP_S = 1e-3


class FaultyWire(Passing):
    """Lies between port and device and spoils things on demand."""

    def __init__(self, device: Device) -> None:
        super().__init__(device)
        self.unplugged = False
        self.flip_answer: int | None = None  # which answer, from now on, gets one bit flipped
        self.lose_answer: int | None = None
        self.interrupt = False

    def feed(self, data: bytes, now: float) -> list[Emission]:
        if self.unplugged:
            raise serial.SerialException("device disconnected")
        answers = self._device.feed(data, now)
        if self.interrupt:
            self.interrupt = False
            raise KeyboardInterrupt
        if self.flip_answer is not None and answers:
            instant, raw = answers[self.flip_answer]
            answers[self.flip_answer] = instant, raw[:-1] + bytes([raw[-1] ^ 4])
            self.flip_answer = None
        if self.lose_answer is not None and answers:
            del answers[self.lose_answer]
            self.lose_answer = None
        return answers


@dataclass
class Bench:
    clock: VirtualClock = field(default_factory=VirtualClock)
    load_nm: float = 0.0
    stepped_s: float = 0.0
    retries: int = 2
    firmware: int | None = None

    def __post_init__(self) -> None:
        self.emulated = {dxl_id: EmulatedServo(dxl_id, firmware=self.firmware) for dxl_id in (11, 12, 13)}
        self.wire = FaultyWire(ServoChain(list(self.emulated.values()), self._advance))
        self.hub = MockHub(self.clock, "servos")
        self.url = self.hub.attach("bus", self.wire, BAUD)
        self.bus = Bus(open_port(self.url, BAUD), self.clock, BAUD, latency_s=1e-3, retries=self.retries)
        self.servos = [Servo(self.bus, dxl_id) for dxl_id in self.emulated]
        self.reader = StateReader(self.bus, self.servos)
        self.reader.arrange()

    def _advance(self, now: float) -> None:
        while self.stepped_s + STEP_S <= now:
            for servo in self.emulated.values():
                servo.step(STEP_S, self.load_nm)
            self.stepped_s += STEP_S

    def states(self) -> dict[int, ServoState]:
        return self.reader.read(self.servos).all()

    def wait(self, seconds: float) -> None:
        self.clock.sleep(seconds)

    def torque_on(self, mode: OperatingMode = OperatingMode.POSITION) -> None:
        for servo in self.servos:
            servo.prepare(mode, current_limit_a=1.0)
            servo.set_profile(2.0, 20.0)
            servo.enable_torque()


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.bus.close()
    bench.hub.close()


@pytest.fixture
def older() -> Iterator[Bench]:
    """Servos whose firmware knows no fast reads: a group of them is read plainly, one answer each."""
    bench = Bench(firmware=44)
    yield bench
    bench.bus.close()
    bench.hub.close()


def test_ping_and_check(bench: Bench) -> None:
    assert bench.bus.ping(12) == Ping(model_number=1020, firmware=45)
    assert bench.servos[0].check() == Ping(1020, 45)
    with pytest.raises(
        DeviceError, match=r"servo 11 on mock://servos/bus answers as XM430-W350 .* not XL330"
    ):
        Servo(bench.bus, 11, "XL330-M288").check()


def test_prepare_writes_only_what_differs(bench: Bench) -> None:
    servo = bench.servos[0]
    servo.prepare(OperatingMode.CURRENT_BASED_POSITION, 1.0)
    assert bench.bus.read(11, ct.ITEMS["Operating Mode"]) == 5
    assert bench.bus.read(11, ct.ITEMS["Current Limit"]) == 371  # 1 A in units of 2.69 mA, rounded down
    assert bench.bus.read(11, ct.RETURN_DELAY_TIME) == 0
    servo.enable_torque()
    bench.bus.write(11, ct.ITEMS["Profile Velocity"], 33)
    servo.prepare(OperatingMode.CURRENT_BASED_POSITION, 1.0)
    assert bench.bus.read(11, ct.TORQUE_ENABLE) == 0
    assert bench.bus.read(11, ct.ITEMS["Profile Velocity"]) == 33  # a rewritten mode would have reset it
    with pytest.raises(ValueError, match="servo 11"):
        servo.prepare(OperatingMode.POSITION, 10.0)


def test_goals_are_reached_in_radians(bench: Bench) -> None:
    bench.torque_on(OperatingMode.CURRENT_BASED_POSITION)
    goals = dict(zip(bench.servos, (0.5, -1.25, 3.0), strict=True))
    write_goals(bench.bus, goals)
    bench.wait(4.0)
    states = bench.states()
    for servo, goal in goals.items():
        state = states[servo.dxl_id]
        assert state.position_rad == pytest.approx(goal, abs=3 * ct.RAD_PER_TICK)
        assert state.position_rad == pytest.approx(
            bench.emulated[servo.dxl_id].shaft_rad, abs=0.5001 * ct.RAD_PER_TICK
        )
        assert state.velocity_rad_s == 0.0


def test_current_tells_the_load(bench: Bench) -> None:
    bench.torque_on(OperatingMode.CURRENT_BASED_POSITION)
    bench.servos[0].set_goal_current_a(0.5)
    write_goals(bench.bus, {bench.servos[0]: 3.0})
    bench.load_nm = -3.0  # more than 0.5 A can hold
    bench.wait(0.5)
    state = bench.states()[11]
    assert state.current_a == pytest.approx(0.5, abs=2.7e-3)
    assert state.velocity_rad_s < 0


def test_out_of_range_goals_send_nothing(bench: Bench) -> None:
    bench.torque_on()
    low_first = {bench.servos[0]: 0.3, bench.servos[1]: 4.0}
    with pytest.raises(SafetyStop, match=r"servo 12 .* 4\.0000 rad, outside its range"):
        write_goals(bench.bus, low_first)
    with pytest.raises(SafetyStop, match="nan"):
        write_goals(bench.bus, {bench.servos[0]: math.nan})
    bench.wait(1.0)
    assert all(abs(s.shaft_rad) < 1e-3 for s in bench.emulated.values())


@pytest.mark.parametrize(("velocity", "acceleration"), [(0.0, 1.0), (0.01, 1.0), (1.0, 0.1), (math.nan, 1.0)])
def test_a_profile_that_would_mean_unlimited_is_refused(
    bench: Bench, velocity: float, acceleration: float
) -> None:
    with pytest.raises(ValueError, match="profile"):
        bench.servos[0].set_profile(velocity, acceleration)


@pytest.mark.parametrize(("fault", "error"), [("flip_answer", DamagedAnswer), ("lose_answer", NotAnswering)])
def test_a_spoilt_answer_is_asked_for_again(older: Bench, fault: str, error: type[DeviceError]) -> None:
    setattr(older.wire, fault, 1)
    assert set(older.states()) == {11, 12, 13}
    assert older.bus.counts.retries == 1
    assert older.bus.counts.damaged + older.bus.counts.silent == 1
    impatient = Bench(retries=0, firmware=44)
    setattr(impatient.wire, fault, 1)
    states = impatient.reader.read(impatient.servos)
    assert set(states.values) == {11, 13}
    assert [type(found) for found in states.errors.values()] == [error]
    with pytest.raises(error) as caught:
        states.all()
    assert caught.value.dxl_ids == (12,)  # type: ignore[attr-defined]
    assert set(impatient.states()) == {11, 12, 13}


def test_a_spoilt_single_answer(bench: Bench) -> None:
    bench.wire.flip_answer = 0
    assert bench.bus.read(11, ct.ITEMS["Model Number"]) == 1020
    assert bench.bus.counts.damaged == bench.bus.counts.retries == 1
    impatient = Bench(retries=0)
    impatient.wire.flip_answer = 0
    with pytest.raises(DamagedAnswer, match="servo 11"):
        impatient.bus.read(11, ct.ITEMS["Model Number"])
    assert impatient.bus.read(11, ct.ITEMS["Model Number"]) == 1020


def test_refusals_carry_the_manuals_name(bench: Bench) -> None:
    with pytest.raises(StatusError, match=r"servo 13 .* refused 5000 .*: Data Limit Error") as caught:
        bench.bus.write(13, ct.ITEMS["Goal Position"], 5000)
    assert caught.value.code is StatusErrorCode.DATA_LIMIT_ERROR


def test_a_refusal_of_many_items_does_not_print_them_as_one_number(bench: Bench) -> None:
    whole = Item("Indirect Address 1 to 14", 168, 28)
    with pytest.raises(StatusError, match="refused a value for Indirect Address 1 to 14: Data") as caught:
        bench.bus.write(11, whole, int.from_bytes(b"\xff" * 28, "little"))
    assert not any(len(digits) > 3 for digits in re.findall(r"[0-9]+", str(caught.value)))


def test_a_hardware_alert_carries_its_cause(bench: Bench) -> None:
    bench.torque_on()
    bench.emulated[12].report_hardware_error(OVERLOAD_BIT)
    with pytest.raises(HardwareAlert, match=r"servo 12 .* \(overload\)") as caught:
        bench.states()
    assert caught.value.cause == HardwareError.OVERLOAD
    assert bench.bus.hardware_error(12) == HardwareError.OVERLOAD
    assert disable_torque(bench.bus, bench.servos) == []  # it confirmed, and is off
    bench.bus.reboot(12)
    with pytest.raises(NotAnswering):
        bench.bus.ping(12)
    bench.wait(0.5)
    bench.bus.ping(12)
    bench.bus.read(12, ct.ITEMS["Present Position"])


def test_torque_goes_off_on_all_others(bench: Bench) -> None:
    bench.torque_on()
    bench.emulated[11].power_off()
    errors = disable_torque(bench.bus, bench.servos)
    assert [str(error).split(" on ")[0] for error in errors] == ["servo 11"]
    assert bench.bus.read(12, ct.TORQUE_ENABLE) == 0
    assert bench.bus.read(13, ct.TORQUE_ENABLE) == 0


def test_torque_goes_off_after_an_interrupt(bench: Bench) -> None:
    bench.torque_on()
    bench.wire.interrupt = True
    with pytest.raises(KeyboardInterrupt):
        bench.states()
    assert disable_torque(bench.bus, bench.servos) == []
    assert all(bench.bus.read(dxl_id, ct.TORQUE_ENABLE) == 0 for dxl_id in bench.emulated)


def test_an_unplugged_port_is_named_and_comes_back(bench: Bench) -> None:
    bench.wire.unplugged = True
    with pytest.raises(PortFailed, match="mock://servos/bus failed: device disconnected"):
        bench.bus.ping(11)
    assert len(disable_torque(bench.bus, bench.servos)) == 3
    bench.wire.unplugged = False
    assert bench.bus.ping(11).model_number == 1020


def test_watchdog_stops_a_servo_that_hears_nothing(bench: Bench) -> None:
    bench.torque_on(OperatingMode.EXTENDED_POSITION)
    servo = bench.servos[0]
    servo.arm_watchdog(0.1)
    write_goals(bench.bus, {servo: 3.0})
    for _ in range(5):
        bench.wait(0.05)
        assert not bench.states()[11].watchdog_tripped
    bench.wait(0.3)
    assert bench.states()[11].watchdog_tripped
    assert bench.emulated[11].shaft_rad < 2.0
    with pytest.raises(StatusError):
        servo.write("Goal Position", servo.goal_ticks(0.0))
    servo.disarm_watchdog()
    write_goals(bench.bus, {servo: 0.0})


def test_a_sync_read_takes_the_time_that_the_wire_needs(older: Bench) -> None:
    older.torque_on()  # sets Return Delay Time 0
    older.wait(1.0)
    older.bus.sync_write(
        ct.ITEMS["LED"], {11: 1}
    )  # after an answer the bus listens before it speaks; not after this
    start = older.clock.now()
    older.states()
    assert older.clock.now() - start == pytest.approx(group_read_time_s([14] * 3, BAUD), abs=1e-6)


def test_a_recorded_bus_has_the_packets_of_the_manual(bench: Bench) -> None:
    listener = Listener(bench.clock)
    log = listener.heard
    url = bench.hub.attach("other", ServoChain([EmulatedServo(1)], lambda _: None), BAUD)
    bus = Bus(listener.on(open_port(url, BAUD)), bench.clock, BAUD)
    assert bus.read(1, ct.ITEMS["Present Position"]) == 2048
    assert log[0][0] is Direction.SENT
    assert log[0][2] == bytes.fromhex("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15")
    assert all(direction is Direction.RECEIVED for direction, _, _ in log[1:])
    answer = encode_status(StatusPacket(1, 0, (2048).to_bytes(4, "little")))
    assert b"".join(data for _, _, data in log[1:]) == answer
    # 14 bytes there, the default return delay, 15 bytes back
    assert log[-1][1] - log[0][1] == pytest.approx(14e-5 + 500e-6 + 15e-5)
    bus.close()
    with pytest.raises(PortFailed, match="other"):
        bus.ping(1)


def test_closing_twice_is_harmless(bench: Bench) -> None:
    bench.bus.close()
    bench.bus.close()
    with pytest.raises(PortFailed):
        bench.bus.ping(11)
