"""Models of emulated servos: protection, rates, limits, a whole rig."""

import math
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from palpate.base.errors import InputError
from palpate.config import load_rig
from palpate.config.rig_tables import BUS_BAUDRATES
from palpate.drivers.dynamixel import Bus, NotAnswering
from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.control_table import BAUD_RATES, Access
from palpate.drivers.dynamixel.errors import StatusError
from palpate.drivers.dynamixel.packet import (
    Instruction,
    InstructionPacket,
    StatusErrorCode,
    encode_instruction,
)
from palpate.drivers.dynamixel.x_series import MODEL_NAMES, X_SERIES, XModel, table_of
from palpate.drivers.emulators.pseudo_terminal import serve_pty
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.emulators.servo_firmware import (
    ELECTRICAL_SHOCK_BIT,
    ENCODER_BIT,
    INPUT_VOLTAGE_BIT,
    OVERHEATING_BIT,
    OVERLOAD_BIT,
)
from palpate.drivers.transport.clock import Clock, MonotonicClock, VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.rig.emulated.devices import emulate, on_mock_wires
from support.benches.rigs import firm_rig
from support.campaign.sampling import sample
from support.devices.servo_wire import Console

# ----------------------------------------------------------------------------------------------------
# What the emulated servos protect themselves from: e-Manual, "Shutdown", voltage and temperature limits.

POSITION, PWM = 3, 16
ALL_BITS = [INPUT_VOLTAGE_BIT, OVERHEATING_BIT, ENCODER_BIT, ELECTRICAL_SHOCK_BIT, OVERLOAD_BIT]


@pytest.mark.parametrize("mask", [0, 52, 53, 63])
@pytest.mark.parametrize("bit", ALL_BITS)
def test_shutdown_selects_what_switches_torque_off(mask: int, bit: int) -> None:
    console = Console()
    console.write(63, mask, 1)
    console.start(POSITION)
    console.servo.report_hardware_error(bit)
    assert console.read(70, 1) == bit
    assert console.read(64, 1) == int(not mask & bit)
    if mask & bit:
        assert console.write(64, 1, 1) == 0x80 | StatusErrorCode.RESULT_FAIL


def test_a_reboot_is_the_way_back() -> None:
    console = Console()
    console.start(POSITION)
    console.servo.report_hardware_error(OVERLOAD_BIT)
    console.send(8)
    console.run(0.5)
    assert console.read(70, 1) == 0
    assert console.write(64, 1, 1) == 0


@pytest.mark.parametrize(("model", "volts"), [("XM430-W350", 9.4), ("XM430-W350", 16.1), ("XC330-M288", 7.1)])
def test_a_supply_out_of_its_limits(model: str, volts: float) -> None:
    console = Console(model=model)
    console.start(POSITION)
    console.servo.set_supply(volts)
    console.run(0.2)
    assert console.read(144, 2) == round(10 * volts)
    assert console.read(70, 1) == INPUT_VOLTAGE_BIT
    assert console.read(64, 1) == 1  # Shutdown does not select it by default


def test_an_xl330_shuts_down_at_a_wrong_voltage() -> None:
    console = Console(model="XL330-M288")
    console.start(POSITION)
    console.servo.set_supply(3.4)
    console.run(0.2)
    assert (console.read(70, 1), console.read(64, 1)) == (INPUT_VOLTAGE_BIT, 0)


@pytest.mark.parametrize("volts", [9.5, 16.0])
def test_the_limits_themselves_are_allowed(volts: float) -> None:
    console = Console()
    console.servo.set_supply(volts)
    console.run(0.3)
    assert console.read(70, 1) == 0


def test_speed_follows_the_supply() -> None:
    console = Console()
    console.servo.set_supply(14.8)
    console.start(PWM)
    console.write(100, 885, 2)
    console.run(2)
    # e-Manual: 57 rpm at 14.8 V; in proportion from 46 rpm at 12 V
    assert console.servo.shaft_rad_s == pytest.approx(57 * 2 * 3.14159 / 60, rel=0.02)


def test_a_brown_out_is_a_restart() -> None:
    console = Console()
    console.write(38, 500, 2)
    console.start(POSITION)
    console.write(84, 700, 2)
    console.servo.set_supply(4.0)
    console.run(0.1, load_nm=1.0)
    assert not console.servo.listening
    assert console.servo.shaft_rad > 0.1  # nothing holds it
    console.servo.set_supply(12.0)
    assert not console.servo.listening
    console.run(0.5)
    assert console.servo.listening
    assert (console.read(64, 1), console.read(84, 2), console.read(38, 2)) == (0, 800, 500)
    assert console.read(70, 1) == 0


def test_overheating() -> None:
    console = Console()
    console.start(POSITION)
    console.servo.set_temperature(80.4)
    console.run(0.2)
    assert (console.read(146, 1), console.read(70, 1)) == (80, 0)  # the limit itself is allowed
    console.servo.set_temperature(82.0)
    console.run(0.2)
    assert (console.read(70, 1), console.read(64, 1)) == (OVERHEATING_BIT, 0)


def test_a_stalled_motor_warms_up_and_a_resting_one_cools() -> None:
    console = Console()
    console.write(63, 0, 1)
    console.start(PWM)
    console.write(100, 885, 2)
    console.run(60, load_nm=-4.1, dt=1e-2)
    hot = console.read(146, 1)
    assert 50 < hot < 80
    console.write(64, 0, 1)
    console.run(60, dt=1e-2)
    assert 30 < console.read(146, 1) < hot


def test_a_load_that_a_servo_can_carry_warms_it_within_its_limit() -> None:
    console = Console()
    console.start(POSITION)
    console.run(600, load_nm=-1.2, dt=1e-2)
    assert 30 < console.read(146, 1) < 80
    assert console.read(70, 1) == 0


@pytest.mark.parametrize(("model", "load"), [("XM430-W350", 6.0), ("XL330-M288", 0.8), ("XC330-M288", 1.4)])
def test_overload_of_every_model(model: str, load: float) -> None:
    console = Console(model=model)
    console.start(POSITION)
    console.run(0.9, load_nm=-load)
    assert console.read(70, 1) == 0
    console.run(0.5, load_nm=-load)
    assert (console.read(70, 1), console.read(64, 1)) == (OVERLOAD_BIT, 0)


def test_ram_does_not_survive_and_eeprom_does() -> None:
    console = Console()
    for address, value, size in ((9, 0, 1), (20, 77, 4), (63, 4, 1), (65, 1, 1), (68, 1, 1), (80, 5, 2)):
        console.send(3, address.to_bytes(2, "little") + value.to_bytes(size, "little"))
    console.servo.power_off()
    console.servo.power_on()
    kept = [console.read(a, n) for a, n in ((9, 1), (20, 4), (63, 1), (65, 1), (68, 1), (80, 2))]
    assert kept == [0, 77, 4, 0, 2, 0]


# ----------------------------------------------------------------------------------------------------
# Baud rates on a chain of emulated servos, and packets that are interrupted.

PING_1 = encode_instruction(InstructionPacket(1, Instruction.PING))


def slow_and_fast() -> ServoChain:
    """Servo 1 at 57,600 bps, servo 2 at 1 Mbps."""
    return ServoChain([EmulatedServo(1, baud_rate_code=1), EmulatedServo(2)], lambda _: None)


@pytest.fixture(params=["mock", pytest.param("pty", marks=pytest.mark.realtime)])
def wire(request: pytest.FixtureRequest) -> Iterator[tuple[str, Clock]]:
    if request.param == "mock":
        clock = VirtualClock()
        hub = MockHub(clock, "rates")
        yield hub.attach("bus", slow_and_fast(), 1_000_000), clock
        return
    with serve_pty({"bus": (slow_and_fast(), 1_000_000)}, MonotonicClock(), threading.Event()) as service:
        yield service.paths["bus"], MonotonicClock()


def test_a_client_reaches_only_the_servos_at_its_rate(wire: tuple[str, Clock]) -> None:
    url, clock = wire
    for rate, reached in ((57_600, 1), (1_000_000, 2), (4_500_000, None)):
        bus = Bus(open_port(url, rate), clock, rate)
        for dxl_id in (1, 2):
            if dxl_id == reached:
                assert bus.ping(dxl_id).model_number == 1020
            else:
                with pytest.raises(NotAnswering):
                    bus.ping(dxl_id)
        bus.close()


def test_a_new_baud_rate_holds_at_once(wire: tuple[str, Clock]) -> None:
    url, clock = wire
    bus = Bus(open_port(url, 1_000_000), clock, 1_000_000)
    bus.write(2, ct.BAUD_RATE, 6)  # confirmed at the old rate
    with pytest.raises(NotAnswering):
        bus.ping(2)
    bus.close()
    bus = Bus(open_port(url, BAUD_RATES[6]), clock, BAUD_RATES[6])
    assert bus.read(2, ct.BAUD_RATE) == 6
    bus.close()


def test_a_rate_that_the_model_lacks_is_refused() -> None:
    clock = VirtualClock()
    hub = MockHub(clock, "rates")
    chain = ServoChain([EmulatedServo(1, model="XL330-M288"), EmulatedServo(2)], lambda _: None)
    bus = Bus(open_port(hub.attach("bus", chain, 1_000_000), 1_000_000), clock, 1_000_000)
    with pytest.raises(StatusError, match="Data Range Error"):
        bus.write(1, ct.BAUD_RATE, 7)
    bus.write(2, ct.BAUD_RATE, 7)  # 4.5 Mbps, on the XM430 alone


def test_rates_off_by_less_than_three_percent_are_understood() -> None:
    chain = slow_and_fast()
    assert len(chain.feed_at(PING_1, 0.0, 56_000)) == 1
    assert chain.feed_at(PING_1, 1.0, 55_000) == []


def test_an_answer_takes_the_time_of_its_rate() -> None:
    chain = slow_and_fast()
    everybody = encode_instruction(InstructionPacket(0xFE, Instruction.PING))
    [(instant, _)] = chain.feed_at(everybody, 1.0, 57_600)
    assert instant == pytest.approx(1.0005)  # servo 2 does not hear it, and is not waited for


def test_noise_at_another_rate_breaks_a_packet() -> None:
    chain = slow_and_fast()
    assert chain.feed_at(PING_1[:6], 0.0, 57_600) == []
    assert chain.feed_at(b"\x55", 0.0001, 1_000_000) == []
    assert chain.feed_at(PING_1[6:], 0.0002, 57_600) == []
    assert len(chain.feed_at(PING_1, 0.0003, 57_600)) == 1


@pytest.mark.parametrize(("pause_s", "answered"), [(0.0014, True), (0.0016, False)])
def test_a_packet_interrupted_for_longer_than_the_manual_allows(pause_s: float, answered: bool) -> None:
    clock = VirtualClock()
    hub = MockHub(clock, "gaps")
    chain = ServoChain([EmulatedServo(1)], lambda _: None)
    with open_port(hub.attach("bus", chain, 1_000_000), 1_000_000, timeout_s=0.01) as port:
        port.write(PING_1[:6])
        clock.sleep(pause_s)
        port.write(PING_1[6:])
        assert len(port.read(14)) == (14 if answered else 0)


def test_a_pause_that_nobody_saw_is_forgiven() -> None:
    """On a pty only the arrival is seen: late bytes may be the computer's fault."""
    chain = ServoChain([EmulatedServo(1)], lambda _: None)
    assert chain.feed(PING_1[:6], 0.0) == []
    assert len(chain.feed(PING_1[6:], 0.015)) == 1
    assert chain.feed(PING_1[:6], 0.1) == []
    chain.poll(0.102)  # nothing came until then
    assert chain.feed(PING_1[6:], 0.103) == []


# ----------------------------------------------------------------------------------------------------
# Every emulated model against the e-Manual's specifications and control tables.

RPM = 2 * math.pi / 60
MODELS = list(MODEL_NAMES.values())
BY_NAME = {model.name: model for model in X_SERIES.values()}
# one of each family, and the lightest and the heaviest motor
SOME = sample(
    MODELS,
    ["XL330-M077", "XC330-M288", "XC330-T181", "XM335-T323", "XM430-W350", "XH430-V350", "XM540-W270"],
)
SOME_NUMBERS = sample(MODEL_NAMES, [1200, 1220, 1710, 1020, 1050, 1280, 1120])
MEASURED = {"Realtime Tick", "Moving Status", "Present Input Voltage", "Present Temperature"}
# RAM whose start follows from elsewhere: EEPROM or the shaft
FOLLOWING = {"Goal Position", "Present Position", "Position Trajectory"}


@pytest.mark.parametrize("number", MODEL_NAMES)
def test_a_new_servo_reads_the_manuals_defaults(number: int) -> None:
    items = {item.name: item for item in table_of(number, 52)}
    rate = items["Baud Rate"].default
    console = Console(model=MODEL_NAMES[number], firmware=52, baud_rate_code=rate)
    for item in items.values():
        if item.name not in MEASURED | FOLLOWING:
            answer = console.send(
                Instruction.READ, bytes([*divmod(item.address, 256)][::-1]) + bytes([item.size, 0])
            )
            assert answer is not None
            value = int.from_bytes(answer.params, "little", signed=item.signed)
            assert value == item.default, item.name


@pytest.mark.parametrize("model", SOME)
def test_no_load_speed(model: str) -> None:
    console = Console(model=model)
    console.start(16)
    console.write(100, 885, 2)
    console.run(2)
    assert console.servo.shaft_rad_s == pytest.approx(BY_NAME[model].no_load_rpm * RPM, rel=0.02)


@pytest.mark.parametrize("model", SOME)
def test_stall_torque_and_current(model: str) -> None:
    made: XModel = BY_NAME[model]
    torque, current = made.stall_torque_nm, made.stall_current_a
    console = Console(model=model)
    console.start(16)
    console.write(100, 885, 2)
    console.run(0.2, load_nm=-torque)  # friction holds the rest
    assert abs(console.servo.shaft_rad) < 1e-6
    unit = made.family.current_unit_a
    assert console.read(126, 2) * unit == pytest.approx(current, abs=unit)


@pytest.mark.parametrize("model", SOME)
def test_every_model_moves_in_every_position_mode(model: str) -> None:
    for mode in (3, 4, 5):
        console = Console(model=model)
        console.start(mode, velocity=100, acceleration=50)
        console.write(116, 3000, 4)
        console.run(3)
        assert console.read(132, 4) == pytest.approx(3000, abs=5)


def test_the_x330s_take_radio_control_types_and_stay_on_the_bus() -> None:
    console = Console(model="XL330-M288")
    for value, error in ((20, 0), (22, 0), (19, StatusErrorCode.DATA_RANGE_ERROR), (2, 0)):
        assert console.write(13, value, 1) == error
    assert Console().write(13, 1, 1) == StatusErrorCode.DATA_RANGE_ERROR  # Protocol 1.0 is not emulated


def test_pwm_slope_is_stored() -> None:
    console = Console(model="XC330-M288")
    assert console.write(62, 255, 1) == 0
    assert console.write(62, 0, 1) == StatusErrorCode.DATA_RANGE_ERROR
    assert console.read(62, 1) == -1  # 255, read as a signed byte
    assert Console().write(62, 140, 1) == StatusErrorCode.ACCESS_ERROR  # an XM430 has none


def test_an_unknown_model_is_refused() -> None:
    with pytest.raises(InputError, match=r'"XL430-W250".*allowed: "XL330-M077"'):
        EmulatedServo(1, model="XL430-W250")


def test_what_only_some_models_have() -> None:
    """No LED on a closed XW, ports for other devices on an X540, Dual Mode on none that is emulated."""
    wet, strong = Console(model="XW540-T260"), Console(model="XH540-W150")
    assert wet.write(65, 1, 1) == StatusErrorCode.ACCESS_ERROR
    assert Console().write(56, 0, 1) == StatusErrorCode.ACCESS_ERROR
    assert [strong.write(65, 1, 1), strong.write(56, 0, 1), strong.write(152, 1, 2)] == [0, 0, 0]
    assert strong.write(10, 2, 1) == StatusErrorCode.DATA_RANGE_ERROR


@pytest.mark.parametrize("number", SOME_NUMBERS)
def test_every_writable_item_takes_the_ends_of_its_range_and_nothing_beyond(number: int) -> None:
    items = {item.name: item for item in table_of(number, 52)}
    goals = items["Min Position Limit"].default, items["Max Position Limit"].default
    for item in items.values():
        if item.access is Access.R or item.name in (
            "ID",
            "Protocol Type",
            "Drive Mode",
            "Status Return Level",
        ):
            continue
        console = Console(model=MODEL_NAMES[number], firmware=52)
        limits = {"Bus Watchdog": (0, 127), "Goal Position": goals, "Goal Velocity": None}
        ends = limits.get(item.name, (item.low, item.high))
        for value in ends or ():
            assert console.write(item.address, value, item.size) == 0, (item.name, value)
            console.write(64, 0, 1)
        beyond = item.high + 1
        if beyond < 1 << (8 * item.size - (1 if item.signed else 0)):
            answer = console.write(item.address, beyond, item.size)
            assert answer == StatusErrorCode.DATA_RANGE_ERROR, item.name


# ----------------------------------------------------------------------------------------------------
# The servos that a rig file's `[emulation]` table turns into: their models and their baud rate.


def pinged(rig_text: str, folder: Path) -> set[int]:
    """Model numbers of all servos of a rig."""
    path = folder / "rig.toml"
    path.write_text(rig_text)
    rig = load_rig(path)
    mock = on_mock_wires(emulate(rig, (), seed=1))
    bus = Bus(open_port(mock.urls[rig.bus.port], rig.bus.baudrate_bps), mock.clock, rig.bus.baudrate_bps)
    numbers = {bus.ping(s.dxl_id).model_number for finger in rig.fingers for s in finger.servos.values()}
    bus.close()
    return numbers


@pytest.mark.parametrize("number", SOME_NUMBERS)
def test_the_rig_file_names_the_model(number: int, tmp_path: Path) -> None:
    text = firm_rig().read_text()
    assert pinged(text.replace("XM430-W350", MODEL_NAMES[number]), tmp_path) == {number}


@pytest.mark.parametrize("rate", BUS_BAUDRATES)
def test_servos_are_set_to_the_buss_rate(rate: int, tmp_path: Path) -> None:
    text = firm_rig().read_text()
    assert "baudrate_bps = 1000000" in text
    assert pinged(text.replace("baudrate_bps = 1000000", f"baudrate_bps = {rate}"), tmp_path) == {1020}
