"""Group reads and writes of the bus, and the loop of a rig."""

import threading
from collections.abc import Callable
from functools import partial

import pytest
import serial

from palpate.base.errors import DeviceError
from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import HardwareError
from palpate.drivers.dynamixel.errors import HardwareAlert, NotAnswering, NotConfirmed, PortFailed, Restarted
from palpate.drivers.dynamixel.exchanges import fast_read_time_s, group_read_time_s
from palpate.drivers.dynamixel.packet import StatusPacket, encode_status
from palpate.drivers.dynamixel.servo import Servo, disable_torque, stop_at, write_goals
from palpate.drivers.dynamixel.servo_state import StateReader
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.emulators.servo_firmware import OVERLOAD_BIT
from palpate.drivers.emulators.wire_faults import FaultRates, FaultyWire, WireRates
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.drivers.transport.wire import Emission
from support.oracles.bus_loop import CASES, BusLoop, LoopCase

# ----------------------------------------------------------------------------------------------------
# Several servos in one instruction: what each answered, what a silent one costs, how fast it is.

LATENCY_S = 1e-3
STATE = 14  # bytes of a servo's state


class Wire:
    """Servos with their torque off and return delay 0 behind a wire that a test may spoil."""

    def __init__(
        self,
        count: int = 4,
        *,
        firmware: int = 44,
        baudrate: int = 1_000_000,
        retries: int = 2,
        model: str = "XM430-W350",
    ) -> None:
        self.clock = VirtualClock()
        code = {1_000_000: 3, 4_000_000: 6}[baudrate]
        self.emulated = {
            dxl_id: EmulatedServo(dxl_id, model=model, firmware=firmware, baud_rate_code=code)
            for dxl_id in range(1, count + 1)
        }
        chain = ServoChain(list(self.emulated.values()), lambda _: None, baudrate=baudrate)
        self.faulty = FaultyWire(chain, 5)
        self.hub = MockHub(self.clock, "group")
        url = self.hub.attach("bus", self.faulty, baudrate)

        def reopen() -> serial.SerialBase:
            return open_port(url, baudrate)

        self.bus = Bus(reopen(), self.clock, baudrate, latency_s=LATENCY_S, retries=retries, reopen=reopen)
        self.servos = [Servo(self.bus, dxl_id, model) for dxl_id in self.emulated]
        for servo in self.servos:
            servo.check()
            servo.ensure("Return Delay Time", 0)
        self.reader = StateReader(self.bus, self.servos)
        self.reader.arrange()

    def took(self, action: Callable[[], object]) -> float:
        """Seconds on the wire; the pause in which the bus listens before it speaks again is not counted."""
        self.clock.sleep(1.0)
        self.bus.sync_write(ct.ITEMS["LED"], {1: 0})
        begin = self.clock.now()
        action()
        return self.clock.now() - begin


@pytest.mark.parametrize("silent", [1, 3, 4])
def test_a_silent_servo_costs_its_own_time_out_and_hides_nobody(silent: int) -> None:
    """Behind a missing servo the emulated ones wait for ever, as real ones may."""
    wire = Wire(retries=0)
    whole = wire.took(lambda: wire.reader.read(wire.servos))
    wire.emulated[silent].power_off()
    took = wire.took(lambda: wire.reader.read(wire.servos))
    timeout = wire.bus.timing.timeout_s(0, 11 + STATE, 0.0)
    asking_again = group_read_time_s([], 1_000_000) + 4e-5
    assert took <= whole + timeout + asking_again + 1.1e-3  # a read waits for up to 1 ms in the port
    assert timeout < 2e-3, "the SDK waits 34 ms"
    states = wire.reader.read(wire.servos)
    assert set(states.values) == set(wire.emulated) - {silent}
    assert [type(error) for error in states.errors.values()] == [NotAnswering]
    with pytest.raises(NotAnswering, match=rf"servo {silent} on mock://group\S*/bus does not answer"):
        states.all()


def test_one_that_stays_silent_is_asked_once_and_last() -> None:
    wire = Wire()
    wire.emulated[1].power_off()
    first = wire.took(lambda: wire.reader.read(wire.servos))
    counts = wire.bus.counts.silent
    assert counts == len(wire.bus.timing.tries(2)), "it and its retries"
    later = wire.took(lambda: wire.reader.read(wire.servos))
    assert wire.bus.counts.silent == counts + 1
    assert later < first
    wire.emulated[1].power_on()
    assert isinstance(wire.reader.read(wire.servos).errors[1], Restarted)


def test_all_silent_are_named() -> None:
    wire = Wire()
    for dxl_id in (2, 4):
        wire.emulated[dxl_id].power_off()
    with pytest.raises(NotAnswering) as caught:
        wire.reader.read(wire.servos).all()
    assert caught.value.dxl_ids == (2, 4)


def test_an_alerting_servo_has_its_values_and_its_cause() -> None:
    wire = Wire()
    wire.emulated[2].report_hardware_error(OVERLOAD_BIT)
    block = wire.bus.sync_read([1, 2, 3], ct.ITEMS["Present Position"])
    assert block.values == {1: 2048, 2: 2048, 3: 2048}
    assert list(block.errors) == [2]
    states = wire.reader.read(wire.servos)
    assert states.values[2].hardware_error == HardwareError.OVERLOAD
    error = states.errors[2]
    assert isinstance(error, HardwareAlert)
    assert error.cause == HardwareError.OVERLOAD
    assert wire.bus.counts.alerts > 0


def test_a_servo_that_was_without_power_for_a_moment_is_not_read_as_zero() -> None:
    wire = Wire()
    wire.emulated[3].power_off()
    wire.emulated[3].power_on()
    states = wire.reader.read(wire.servos)
    assert 3 not in states.values
    with pytest.raises(Restarted, match=r"servo 3 .* has restarted, with torque off"):
        states.all()
    wire.reader.arrange()
    assert wire.reader.read(wire.servos).all()[3].position_rad == 0.0


@pytest.mark.parametrize(("firmware", "model"), [(45, "XM430-W350"), (52, "XL330-M288"), (46, "XC330-M288")])
def test_fast_reads_are_used_where_the_firmware_has_them(firmware: int, model: str) -> None:
    wire = Wire(firmware=firmware, model=model)
    took = wire.took(lambda: wire.reader.read(wire.servos).all())
    assert took == pytest.approx(fast_read_time_s([STATE] * 4, 1_000_000), abs=1e-6)
    wire.emulated[2].power_off()
    states = wire.reader.read(wire.servos)
    assert set(states.values) == {1, 3, 4}
    assert [type(error) for error in states.errors.values()] == [NotAnswering]
    later = wire.took(lambda: wire.reader.read(wire.servos))
    assert later < took + 3e-3, "the silent one is left out of the fast read"


@pytest.mark.parametrize("silent", [1, 2, 4])
def test_a_servo_that_falls_silent_is_noticed_as_soon_with_fast_reads(silent: int) -> None:
    """The fast read is one of the tries, and who answered it shows that the computer is not late."""
    noticed = {}
    for firmware in (44, 45):
        wire = Wire(firmware=firmware)
        wire.emulated[silent].power_off()
        noticed[firmware] = wire.took(partial(wire.reader.read, wire.servos))
    assert noticed[45] <= noticed[44]


def test_one_old_firmware_and_all_are_read_plainly() -> None:
    wire = Wire(firmware=45)
    old = EmulatedServo(1, firmware=44)
    wire.emulated[1].__dict__.update(old.__dict__)
    for servo in wire.servos:
        servo.check()
    wire.reader.arrange()
    took = wire.took(lambda: wire.reader.read(wire.servos).all())
    assert took == pytest.approx(group_read_time_s([STATE] * 4, 1_000_000) + 5e-4, abs=1e-6)


def test_bulk_reads_take_an_item_of_each() -> None:
    for firmware in (44, 45):
        wire = Wire(firmware=firmware)
        items = {
            1: ct.ITEMS["Present Input Voltage"],
            2: ct.ITEMS["Present Temperature"],
            3: ct.ITEMS["Present Position"],
        }
        found = wire.bus.bulk_read(items, fast=firmware == 45).all()
        assert found == {1: 120, 2: 30, 3: 2048}


def test_goals_that_get_lost_are_written_again_until_they_are_there() -> None:
    wire = Wire()
    wire.faulty.rates = WireRates(to_device=FaultRates(lost=0.2))
    for step in range(10):
        write_goals(wire.bus, dict.fromkeys(wire.servos, 0.01 * step), confirm=True)
        held = {dxl_id: servo.answer_block(116, 4) for dxl_id, servo in wire.emulated.items()}
        for answer in held.values():
            assert answer is not None
            assert int.from_bytes(answer.params, "little") == round(0.01 * step / ct.RAD_PER_TICK) + 2048


def test_a_stop_that_nobody_takes_is_an_error() -> None:
    wire = Wire()
    unruly = wire.emulated[2]
    unruly.take_block = lambda _address, _data: None  # type: ignore[method-assign]
    with pytest.raises(NotConfirmed, match=r"servo 2 on .* did not take Profile Velocity and Goal Position"):
        stop_at(wire.bus, dict.fromkeys(wire.servos, 0.5))


def test_torque_goes_off_on_a_wire_that_loses_every_third_packet() -> None:
    for seed in range(20):
        wire = Wire()
        for servo in wire.servos:
            servo.enable_torque()
        wire.faulty._chance_out.bit_generator.advance(seed * 1000)  # type: ignore[attr-defined]
        wire.faulty.rates = WireRates(FaultRates(lost=0.2), FaultRates(lost=0.2))
        assert disable_torque(wire.bus, wire.servos) == []
        assert not any(servo.answer_block(64, 1).params[0] for servo in wire.emulated.values())  # type: ignore[union-attr]


def test_a_servo_that_answers_only_pings_is_made_to_answer() -> None:
    wire = Wire()
    for level in (0, 1):
        wire.bus.write_unconfirmed(2, ct.ITEMS["Status Return Level"], level)
        wire.servos[1].check()
        wire.servos[1].disable_torque()
        assert wire.bus.read(2, ct.ITEMS["Status Return Level"]) == 2


def test_a_ping_to_all_ends_when_all_that_are_wanted_have_answered() -> None:
    wire = Wire()
    assert wire.took(lambda: wire.bus.broadcast_ping(list(wire.emulated))) < 3e-3, "the SDK waits 0.81 s"
    found = wire.bus.broadcast_ping(range(20))
    assert {dxl_id: answer.model_number for dxl_id, answer in found.items()} == dict.fromkeys(
        wire.emulated, 1020
    )


def test_an_adapter_that_is_plugged_in_again_is_found() -> None:
    wire = Wire()
    wire.faulty.unplugged = True
    for _ in range(2):
        with pytest.raises(PortFailed, match=r"mock://group\S*/bus failed"):
            wire.bus.ping(1)
    with pytest.raises(DeviceError):
        wire.bus.reconnect()
    wire.faulty.unplugged = False
    wire.bus.reconnect()
    assert wire.bus.ping(1).model_number == 1020
    assert wire.bus.counts.reconnects == 1


def test_two_threads_do_not_speak_at_once() -> None:
    wire = Wire()
    wrong: list[object] = []

    def work(item: ct.Item, expected: int) -> None:
        try:
            wrong.extend(value for _ in range(150) if (value := wire.bus.read(1, item)) != expected)
        except DeviceError as error:
            wrong.append(error)

    asked = [
        (ct.ITEMS["Present Position"], 2048),
        (ct.ITEMS["Profile Velocity"], 0),
        (ct.ITEMS["Current Limit"], 1193),
    ]
    threads = [threading.Thread(target=work, args=pair) for pair in asked]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
    assert wire.bus.counts.damaged == wire.bus.counts.silent == 0


class Babbler:
    """Somebody else's servo, 99, whose answers never end."""

    def __init__(self) -> None:
        self._next_s = 0.0

    def feed(self, data: bytes, now: float) -> list[Emission]:
        del data
        return self.poll(now)

    def poll(self, now: float) -> list[Emission]:
        found = []
        while self._next_s <= now:
            found.append((self._next_s, encode_status(StatusPacket(99, 0, b"\1\2\3\4"))))
            self._next_s += 2e-4
        return found

    def next_due(self) -> float | None:
        return self._next_s


def test_a_wire_on_which_somebody_else_never_stops_does_not_hold_the_bus() -> None:
    clock = VirtualClock()
    hub = MockHub(clock, "babble")
    url = hub.attach("bus", Babbler(), 1_000_000)
    bus = Bus(open_port(url, 1_000_000), clock, 1_000_000, latency_s=LATENCY_S)
    with pytest.raises(NotAnswering):
        bus.read(1, ct.ITEMS["Present Position"])
    assert set(bus.sync_read([1, 2, 3], ct.ITEMS["Present Position"]).errors) == {1, 2, 3}
    assert set(bus.broadcast_ping([1, 2])) <= {99}
    assert clock.now() < 3.0


# ----------------------------------------------------------------------------------------------------
# A control loop's time on the bus: what the formulas for the wire say, and little more. In virtual time.

CYCLES = 20


@pytest.mark.parametrize("case", CASES, ids=str)
def test_reading_and_writing_all_takes_what_the_wire_takes(case: LoopCase) -> None:
    clock = VirtualClock()
    hub = MockHub(clock, "loop")
    loop = BusLoop(case, open_port(hub.attach("bus", case.chain(), case.baudrate), case.baudrate), clock)
    assert loop.reader.is_fast == (case.firmware >= 45)
    begin = clock.now()
    for number in range(CYCLES):
        loop.cycle(number)
    spent = (clock.now() - begin) / CYCLES
    assert loop.wire_s <= spent + 1e-9
    assert spent <= 1.3 * loop.wire_s
    assert loop.bus.counts.retries == loop.bus.counts.silent == loop.bus.counts.damaged == 0
