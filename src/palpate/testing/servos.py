"""Conformance of servo models: a table that the host can work with, and an emulated servo that it can move.

class TestMyServo(ServoConformance):
    model = "XZ330-M999"
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import pytest

from palpate.base.errors import InputError
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import ITEMS, OperatingMode
from palpate.drivers.dynamixel.emanual_tables import Access
from palpate.drivers.dynamixel.models import model_named, model_numbered
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.dynamixel.specifications import specification
from palpate.drivers.emulators.chain import ServoChain
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.port import open_port

__all__ = ["ServoBench", "ServoConformance"]

_BAUD = 1_000_000
_STEP_S = 1e-3
_SOME_MODELS_LACK = {"PWM Slope", "LED"}


@dataclass
class ServoBench:
    """One emulated servo with ID 1 on a mock bus in virtual time, and its driver."""

    model: str
    load_nm: float = 0.0

    def __post_init__(self) -> None:
        self.emulated = EmulatedServo(1, model=self.model)
        self.clock = VirtualClock()
        self._stepped_s = 0.0
        self.hub = MockHub(self.clock, "servo")
        url = self.hub.attach("bus", ServoChain([self.emulated], self._advance), _BAUD)
        self.bus = Bus(open_port(url, _BAUD), self.clock, _BAUD, latency_s=1e-3)
        self.servo = Servo(self.bus, 1, self.model)

    def _advance(self, now: float) -> None:
        while self._stepped_s + _STEP_S <= now:
            self.emulated.step(_STEP_S, self.load_nm)
            self._stepped_s += _STEP_S


class ServoConformance:
    """The suite: a subclass names `model` as a rig file does."""

    model: ClassVar[str]

    @pytest.fixture
    def bench(self) -> Iterator[ServoBench]:
        """A bench of its own for each test."""
        bench = ServoBench(self.model)
        yield bench
        bench.bus.close()

    def test_is_registered_under_its_own_name(self) -> None:
        assert specification(self.model).name == self.model

    def test_items_do_not_overlap_and_can_hold_their_values(self) -> None:
        described = specification(self.model)
        for firmware in (described.firmware, described.extended_firmware, 255):
            items = sorted(described.items(firmware), key=lambda item: item.address)
            assert len({item.name for item in items}) == len(items)
            for item, following in zip(items, [*items[1:], None], strict=True):
                assert item.size in (1, 2, 4), item
                assert following is None or item.address + item.size <= following.address, item
                lowest = -(1 << 8 * item.size - 1) if item.signed else 0
                highest = (1 << 8 * item.size - item.signed) - 1
                assert lowest <= item.low <= item.high <= highest, item
                if item.access is Access.RW:
                    assert item.low <= item.default <= item.high, item

    def test_has_what_the_host_reads_and_writes_where_the_x_series_has_it(self) -> None:
        described = specification(self.model)
        items = {item.name: item for item in described.items(255)}
        missing = ITEMS.keys() - items.keys() - _SOME_MODELS_LACK
        assert not missing
        for name in ITEMS.keys() & items.keys():
            assert (items[name].address, items[name].size) == (ITEMS[name].address, ITEMS[name].size), name
        assert items["Model Number"].default == described.number

    def test_agrees_with_the_table_of_the_vendors_sdk_if_that_has_the_model(self) -> None:
        described = specification(self.model)
        try:
            vendor = model_numbered(described.number, described.firmware).items
        except InputError:
            return
        for item in described.items(described.firmware):
            if item.name in vendor:
                assert (item.address, item.size) == (vendor[item.name].address, vendor[item.name].size), item

    def test_answers_as_its_model_and_reports_its_firmware(self, bench: ServoBench) -> None:
        answer = bench.servo.check()
        described = specification(self.model)
        assert (answer.model_number, answer.firmware) == (described.number, described.firmware)
        assert bench.servo.model == model_named(self.model, described.firmware)

    def test_moves_to_a_goal_and_holds_it_against_a_load(self, bench: ServoBench) -> None:
        bench.servo.check()
        largest_a = bench.servo.model.largest_current_a
        bench.servo.prepare(OperatingMode.POSITION, largest_a, velocity_limit_rad_s=3.0)
        bench.servo.set_profile(2.0, 20.0)
        bench.servo.enable_torque()
        bench.servo.write("Goal Position", bench.servo.model.zero_tick + 1024)
        bench.clock.sleep(2.0)
        bench.load_nm = 0.1 * specification(self.model).motor.stall_torque_nm
        bench.clock.sleep(1.0)
        bench.servo.read("Present Position")
        assert bench.emulated.shaft_rad == pytest.approx(math.pi / 2, abs=0.1)

    def test_values_that_it_does_not_take_are_refused_before_they_are_sent(self, bench: ServoBench) -> None:
        limit = specification(self.model).items(255)
        highest = next(item.high for item in limit if item.name == "Current Limit")
        with pytest.raises(ValueError, match="Current Limit"):
            bench.servo.write("Current Limit", highest + 1)
