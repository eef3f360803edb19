"""The bus on a wire that spoils what passes: it may fail and say so, but it never returns a wrong value.

The host keeps a set of what each register may hold. A write that was confirmed leaves one value; one that
failed, or that servos never confirm, leaves the old ones and the new one.
"""

from itertools import product

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test
from sampling import sample

from palpate.base.errors import DeviceError
from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import Item
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.emulators.wire_faults import FaultRates, FaultyWire, WireRates
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port

TRANSACTIONS_OF = {45: 2_000, 180: 10_000}
"""How many transactions so many examples come to, at least."""
IDS = (1, 2, 3)
# neighbours of one size, so that an answer to one could be taken for an answer to the other
REGISTERS = (ct.ITEMS["Goal Position"], ct.ITEMS["Profile Velocity"], ct.ITEMS["Profile Acceleration"])
CALM, NOISY = FaultRates(), FaultRates(flipped=0.01)
LOSSY = FaultRates(lost=0.3, cut=0.05)
LATE = FaultRates(late=0.2, late_s=0.05)
REPEATING = FaultRates(duplicated=0.2)
EVERYTHING = FaultRates(flipped=0.002, lost=0.03, cut=0.02, duplicated=0.05, late=0.05, late_s=0.05)
WEATHER = list(product([CALM, NOISY, LOSSY, LATE, REPEATING, EVERYTHING], repeat=2))
ids = st.sampled_from(IDS)
registers = st.sampled_from(REGISTERS)
# some of them look like headers on the wire
values = st.integers(0, 32_767) | st.sampled_from([0x00FDFFFF & 0x7FFF, 0x7FFF, 253])


class FaultyBusMachine(RuleBasedStateMachine):
    """Three servos with torque off in Extended Position Control Mode, whose shafts stand still."""

    done: list[int]
    failed: list[DeviceError]
    retries: list[int]

    @initialize(seed=st.integers(0, 2**32 - 1))
    def power_up(self, seed: int) -> None:
        self.clock = VirtualClock()
        servos = {dxl_id: EmulatedServo(dxl_id) for dxl_id in IDS}
        self.wire = FaultyWire(ServoChain(list(servos.values()), lambda _: None), seed)
        self.hub = MockHub(self.clock, "faulty")
        url = self.hub.attach("bus", self.wire, 1_000_000)
        self.bus = Bus(open_port(url, 1_000_000), self.clock, 1_000_000, latency_s=1e-3)
        self.may_be: dict[tuple[int, Item], set[int]] = {}
        for dxl_id in IDS:
            self.bus.write(dxl_id, ct.ITEMS["Operating Mode"], ct.OperatingMode.EXTENDED_POSITION)
            for item in REGISTERS:
                self.may_be[dxl_id, item] = {self.bus.read(dxl_id, item)}

    @rule(rates=st.sampled_from(WEATHER))
    def weather(self, rates: tuple[FaultRates, FaultRates]) -> None:
        self.wire.rates = WireRates(*rates)

    @rule(dxl_id=ids, item=registers)
    def read(self, dxl_id: int, item: Item) -> None:
        self.done.append(1)
        try:
            value = self.bus.read(dxl_id, item)
        except DeviceError as error:
            self.failed.append(error)
            return
        self.check(dxl_id, item, value)

    @rule(dxl_id=ids, item=registers, value=values)
    def write(self, dxl_id: int, item: Item, value: int) -> None:
        self.done.append(1)
        self.may_be[dxl_id, item].add(value)
        try:
            self.bus.write(dxl_id, item, value)
        except DeviceError as error:
            self.failed.append(error)
            return
        self.may_be[dxl_id, item] = {value}

    @rule(item=registers, chosen=st.dictionaries(ids, values, min_size=1))
    def sync_write(self, item: Item, chosen: dict[int, int]) -> None:
        self.done.append(1)
        for dxl_id, value in chosen.items():
            self.may_be[dxl_id, item].add(value)
        self.bus.sync_write(item, chosen)

    @rule(item=registers, chosen=st.permutations(IDS))
    def sync_read(self, item: Item, chosen: list[int]) -> None:
        self.done.append(1)
        found = self.bus.sync_read(chosen, item)
        assert found.values.keys() | found.errors.keys() == set(chosen)
        for dxl_id, held in found.values.items():
            self.check(dxl_id, item, held)
        self.failed += found.errors.values()

    @rule(chosen=st.dictionaries(ids, registers, min_size=1))
    def bulk_read(self, chosen: dict[int, Item]) -> None:
        self.done.append(1)
        found = self.bus.bulk_read(chosen)
        for dxl_id, held in found.values.items():
            self.check(dxl_id, chosen[dxl_id], held)
        self.failed += found.errors.values()

    @rule(dxl_id=ids)
    def ping(self, dxl_id: int) -> None:
        self.done.append(1)
        try:
            answer = self.bus.ping(dxl_id)
        except DeviceError as error:
            self.failed.append(error)
            return
        assert (answer.model_number, answer.firmware) == (1020, 45)

    def check(self, dxl_id: int, item: Item, value: int) -> None:
        assert value in self.may_be[dxl_id, item], (dxl_id, item.name, value, self.may_be[dxl_id, item])
        self.may_be[dxl_id, item] = {value}

    def teardown(self) -> None:
        if hasattr(self, "bus"):
            self.retries.append(self.bus.counts.retries)
            self.bus.close()
            self.hub.close()


@pytest.mark.slow
@pytest.mark.parametrize("examples", sample(TRANSACTIONS_OF, [45]))
def test_transactions_on_bad_wires_return_no_wrong_value(examples: int) -> None:
    done: list[int] = []
    failed: list[DeviceError] = []
    retries: list[int] = []

    def machine() -> FaultyBusMachine:
        made = FaultyBusMachine()
        made.done, made.failed, made.retries = done, failed, retries
        return made

    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=examples,
            stateful_step_count=100,
            deadline=None,
            derandomize=True,
            phases=[Phase.generate],  # a failure's bytes tell more than hours of shrinking
            suppress_health_check=list(HealthCheck),
        ),
    )
    assert len(done) >= TRANSACTIONS_OF[examples]
    assert sum(retries) > 0, "wires this bad must lose something"
    assert failed or examples < max(TRANSACTIONS_OF), "and some of it three times in a row"
