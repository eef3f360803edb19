"""Settings that another program has left in a servo: what a run resets, and what it compares."""

from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from palpate.base.errors import DeviceError
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import GAINS, Access, OperatingMode, TableItem
from palpate.drivers.dynamixel.errors import HardwareAlert
from palpate.drivers.dynamixel.servo import Servo, confirm_torque_off
from palpate.drivers.dynamixel.settings import (
    HOMING_OFFSET,
    SECONDARY_ID,
    SETTINGS,
    Owner,
    foreign_settings,
    items_to_compare,
    refuse_foreign_settings,
)
from palpate.drivers.dynamixel.x_series import X_SERIES, table_of
from palpate.drivers.emulators.servo import EmulatedServo
from support.devices.servo_wire import MotorWire

MODES = (OperatingMode.POSITION, OperatingMode.CURRENT_BASED_POSITION, OperatingMode.EXTENDED_POSITION)


class Pair:
    """Two emulated servos, and the first as a host sees it; `poke` is what another program has written."""

    def __init__(self, model: str = "XM430-W350") -> None:
        self.emulated = [EmulatedServo(dxl_id, model=model) for dxl_id in (11, 12)]
        self.wire = MotorWire(self.emulated)
        self.bus = Bus(self.wire.place().open(1_000_000), self.wire.clock, 1_000_000, latency_s=1e-3)
        self.servos = [Servo(self.bus, dxl_id, model) for dxl_id in (11, 12)]
        self.first = self.servos[0]
        self.first.check()

    def poke(self, item: str, value: int) -> None:
        self.emulated[0]._unit.write(self._item(item).address, self._bytes(item, value))

    def holds(self, item: str) -> int:
        return self.emulated[0]._unit.table.get(item)

    def _item(self, name: str) -> TableItem:
        return self.emulated[0]._unit.table.item(name)

    def _bytes(self, name: str, value: int) -> bytes:
        item = self._item(name)
        return value.to_bytes(item.size, "little", signed=item.signed)


@pytest.fixture
def pair() -> Iterator[Pair]:
    made = Pair()
    yield made
    made.bus.close()


@pytest.mark.parametrize("number", X_SERIES)
def test_every_item_that_can_be_written_has_an_owner(number: int) -> None:
    items = [item for item in table_of(number, 255) if item.access is Access.RW]
    others = ("Indirect ", "External Port ")
    assert {item.name for item in items if not item.name.startswith(others)} <= SETTINGS.keys()


def test_items_of_the_table_exist() -> None:
    assert SETTINGS.keys() <= {item.name for number in X_SERIES for item in table_of(number, 255)}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("item", [*GAINS, "Goal PWM"])
def test_gains_of_another_program_are_reset(pair: Pair, mode: OperatingMode, item: str) -> None:
    pair.first.prepare(mode, 1.0)
    usual = {name: pair.holds(name) for name in (*GAINS, "Goal PWM", "Operating Mode")}
    pair.poke(item, 123)
    pair.first.prepare(mode, 1.0)
    assert {name: pair.holds(name) for name in usual} == usual


def test_turns_survive_a_reset_of_gains(pair: Pair) -> None:
    pair.first.prepare(OperatingMode.CURRENT_BASED_POSITION, 1.0)
    pair.emulated[0].motion.shaft_rad += 20.0
    before = pair.first.read("Present Position")
    assert before > 4096
    pair.poke("Position P Gain", 10)
    pair.first.prepare(OperatingMode.CURRENT_BASED_POSITION, 1.0)
    assert pair.holds("Position P Gain") == 800
    assert pair.first.read("Present Position") == before


def test_a_servo_that_would_switch_torque_on_by_itself_is_kept_from_it(pair: Pair) -> None:
    pair.poke("Startup Configuration", 3)
    pair.first.prepare(OperatingMode.POSITION, 1.0)
    pair.bus.reboot(11)
    pair.wire.clock.sleep(1.0)
    assert pair.holds("Torque Enable") == 0


@pytest.mark.parametrize(("found", "kept"), [(0, 200), (5, 200), (200, 200), (300, 300)])
def test_a_velocity_limit_is_raised_to_that_of_the_model_and_never_lowered(
    pair: Pair, found: int, kept: int
) -> None:
    pair.poke("Velocity Limit", found)
    pair.first.prepare(OperatingMode.POSITION, 1.0)
    assert pair.holds("Velocity Limit") == kept


PERSON = sorted(name for name, setting in SETTINGS.items() if setting.owner is Owner.PERSON)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_value_that_is_not_expected_is_found_and_no_other(data: st.DataObject) -> None:
    """Greater values are as good where more does no harm; Shutdown may protect more."""
    pair = Pair(data.draw(st.sampled_from(["XM430-W350", "XL330-M288"])))
    there = [name for name in PERSON if name in items_to_compare(pair.first)]
    item = pair._item(data.draw(st.sampled_from(there)))
    value = data.draw(st.integers(item.low, item.high))
    pair.emulated[0]._unit.table.set(item.name, value)
    wanted = items_to_compare(pair.first)[item.name]
    harmless = value == wanted or (SETTINGS[item.name].floor and value > wanted)
    harmless |= item.name == SECONDARY_ID and value >= 253
    harmless |= item.name == "Shutdown" and value & wanted == wanted
    found = [(change.item, change.found, change.wanted) for change in foreign_settings(pair.bus, pair.first)]
    assert found == ([] if harmless else [(item.name, value, wanted)])
    pair.bus.close()


@pytest.mark.parametrize("offset", [1, -40, 1000, 4096])
def test_a_homing_offset_that_is_not_the_recorded_one_is_refused(pair: Pair, offset: int) -> None:
    pair.poke(HOMING_OFFSET, offset)
    with pytest.raises(DeviceError) as refused:
        refuse_foreign_settings(pair.bus, pair.servos)
    assert refused.value.dxl_ids == (11,)  # type: ignore[attr-defined]
    for word in (HOMING_OFFSET, str(offset), "palpate setup-motors --rig FILE --id 11"):
        assert word in str(refused.value)
    pair.first.homing_offset = offset
    refuse_foreign_settings(pair.bus, pair.servos)


@pytest.mark.parametrize(("shadow", "refused"), [(12, True), (77, False), (255, False)])
def test_a_second_id_is_refused_if_it_is_another_servos(pair: Pair, shadow: int, refused: bool) -> None:
    pair.poke(SECONDARY_ID, shadow)
    if refused:
        with pytest.raises(DeviceError, match=r"servo 11 .* is 12 instead of 255.*setup-motors"):
            refuse_foreign_settings(pair.bus, pair.servos)
    else:
        refuse_foreign_settings(pair.bus, pair.servos)


def test_a_latched_error_is_named_with_its_cause_and_the_command(pair: Pair) -> None:
    pair.emulated[0].report_hardware_error(0x20)
    with pytest.raises(HardwareAlert, match=r"overload.*pushed.*palpate reboot --rig FILE --id 11"):
        refuse_foreign_settings(pair.bus, pair.servos)


@pytest.mark.parametrize("level", [0, 1])
def test_a_servo_that_answers_pings_alone_counts_as_no_loss(pair: Pair, level: int) -> None:
    pair.poke("Status Return Level", level)
    before = pair.bus.counts.silent
    pair.first.check()
    assert pair.bus.counts.silent == before
    assert pair.holds("Status Return Level") == 2


@pytest.mark.parametrize("level", [0, 1])
def test_a_servo_that_confirms_nothing_is_asked_to(pair: Pair, level: int) -> None:
    pair.first.enable_torque()
    pair.poke("Status Return Level", level)
    assert confirm_torque_off(pair.bus, [11, 12]) == {11: None, 12: None}


def test_feedforward_drives_ahead_of_the_error(pair: Pair) -> None:
    lags = []
    for gain in (0, 100):
        pair.first.prepare(OperatingMode.EXTENDED_POSITION, 3.0)
        pair.first.set_profile(2.0, 30.0)
        pair.poke("Feedforward 1st Gain", gain)
        pair.first.enable_torque()
        pair.first.write("Goal Position", pair.first.read("Present Position") + 4000)
        pair.wire.clock.sleep(1.0)
        pair.first.read("Present Position")
        motion = pair.emulated[0].motion
        lags.append(motion.reference_rad - motion.shaft_rad)
        pair.first.disable_torque()
    assert lags[1] < lags[0]


@pytest.mark.parametrize("offset", [-700, 0, 700])
def test_an_emulated_servo_with_an_offset_reads_as_if_it_had_none(offset: int) -> None:
    servo = EmulatedServo(5, start_rad=0.3, homing_offset=offset)
    wire = MotorWire([servo])
    bus = Bus(wire.place().open(1_000_000), wire.clock, 1_000_000, latency_s=1e-3)
    host = Servo(bus, 5, homing_offset=offset)
    host.check()
    assert host.read("Present Position") == pytest.approx(2048 + 0.3 / host.model.rad_per_tick, abs=1)
    host.prepare(OperatingMode.POSITION, 1.0)
    host.enable_torque()
    host.write("Goal Position", 2500)
    wire.clock.sleep(3.0)
    assert host.read("Present Position") == pytest.approx(2500, abs=5)
    assert servo.shaft_rad == pytest.approx(452 * host.model.rad_per_tick, abs=0.01)
    bus.close()
