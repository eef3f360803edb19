"""Every emulated model against the e-Manual's specifications and control tables."""

import math

import pytest
from sampling import sample
from servo_console import Console

from palpate.base.errors import InputError
from palpate.drivers.dynamixel.control_table import Access
from palpate.drivers.dynamixel.packet import Instruction, StatusErrorCode
from palpate.drivers.dynamixel.x_series import MODEL_NAMES, X_SERIES, XModel, table_of
from palpate.drivers.emulators.servo import EmulatedServo

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


@pytest.mark.parametrize("model", MODELS)
def test_ping_and_supply(model: str) -> None:
    console = Console(model=model)
    answer = console.send(Instruction.PING)
    assert answer is not None
    assert MODEL_NAMES[int.from_bytes(answer.params[:2], "little")] == model
    assert console.read(144, 2) == round(10 * BY_NAME[model].family.supply_v[1])


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
    with pytest.raises(InputError, match='"XL430-W250"; allowed: "XL330-M077"'):
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
