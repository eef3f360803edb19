"""What the emulated servos protect themselves from: e-Manual, "Shutdown", voltage and temperature limits."""

import pytest
from servo_console import Console

from palpate.drivers.dynamixel.packet import StatusErrorCode
from palpate.drivers.emulators.servo_firmware import (
    ELECTRICAL_SHOCK_BIT,
    ENCODER_BIT,
    INPUT_VOLTAGE_BIT,
    OVERHEATING_BIT,
    OVERLOAD_BIT,
)

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
    assert [console.read(a, n) for a, n in ((9, 1), (20, 4), (63, 1), (65, 1), (68, 1), (80, 2))] == [
        0,
        77,
        4,
        0,
        2,
        0,
    ]
