"""The bus as a state machine: whatever is written, lost or switched off, the host's picture stays right."""

from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.errors import NotAnswering, StatusError
from palpate.drivers.dynamixel.packet import StatusErrorCode
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port

IDS = (1, 2, 3)
ids = st.sampled_from(IDS)
# extended goals, among them those whose bytes look like headers
goals = st.integers(-1_048_575, 1_048_575) | st.sampled_from([-769, -1, -3, -131_073])


class BusMachine(RuleBasedStateMachine):
    """Three servos in Extended Position Control Mode with torque off, and what the host believes of them."""

    @initialize()
    def power_up(self) -> None:
        self.clock = VirtualClock()
        self.emulated = {dxl_id: EmulatedServo(dxl_id) for dxl_id in IDS}
        self.hub = MockHub(self.clock, "machine")
        url = self.hub.attach("bus", ServoChain(list(self.emulated.values()), self._advance), 1_000_000)
        self.bus = Bus(open_port(url, 1_000_000), self.clock, 1_000_000)
        self.dead: set[int] = set()
        self.locked: set[int] = set()
        self.goal: dict[int, int] = {}
        self.limit = dict.fromkeys(IDS, 1193)
        for dxl_id in IDS:
            self.bus.write(dxl_id, ct.ITEMS["Operating Mode"], ct.OperatingMode.EXTENDED_POSITION)
            self.goal[dxl_id] = self.bus.read(dxl_id, ct.ITEMS["Goal Position"])

    def _advance(self, now: float) -> None:
        """The shafts stand still: only the registers matter here."""

    def _expect(self, dxl_id: int, action: Any) -> bool:
        """Run an action; True if the servo is alive, otherwise it must be reported as not answering."""
        if dxl_id not in self.dead:
            action()
            return True
        with pytest.raises(NotAnswering) as caught:
            action()
        assert caught.value.dxl_ids == (dxl_id,)
        return False

    @rule(dxl_id=ids, goal=goals)
    def write_goal(self, dxl_id: int, goal: int) -> None:
        if self._expect(dxl_id, lambda: self.bus.write(dxl_id, ct.ITEMS["Goal Position"], goal)):
            self.goal[dxl_id] = goal

    @rule(chosen=st.dictionaries(ids, goals, min_size=1))
    def sync_write_goals(self, chosen: dict[int, int]) -> None:
        self.bus.sync_write(ct.ITEMS["Goal Position"], chosen)
        self.goal.update({dxl_id: goal for dxl_id, goal in chosen.items() if dxl_id not in self.dead})

    @rule(dxl_id=ids, units=st.integers(0, 1193))
    def write_limit(self, dxl_id: int, units: int) -> None:
        def action() -> None:
            self.bus.write(dxl_id, ct.ITEMS["Current Limit"], units)

        if dxl_id in self.locked and dxl_id not in self.dead:
            with pytest.raises(StatusError) as caught:
                action()
            assert caught.value.code is StatusErrorCode.ACCESS_ERROR
        elif self._expect(dxl_id, action):
            self.limit[dxl_id] = units

    @rule(dxl_id=ids, on=st.booleans())
    def torque(self, dxl_id: int, on: bool) -> None:
        if self._expect(dxl_id, lambda: self.bus.write(dxl_id, ct.TORQUE_ENABLE, int(on))):
            if on and dxl_id not in self.locked:
                self.goal[dxl_id] = 2048  # switching on makes the present position the goal
            (self.locked.add if on else self.locked.discard)(dxl_id)

    @rule(dxl_id=ids)
    def cut_power(self, dxl_id: int) -> None:
        self.emulated[dxl_id].power_off()
        self.dead.add(dxl_id)
        self.locked.discard(dxl_id)

    @rule(dxl_id=ids)
    def restore_power(self, dxl_id: int) -> None:
        if dxl_id in self.dead:
            self.emulated[dxl_id].power_on()
            self.dead.discard(dxl_id)
            self.goal[dxl_id] = 2048

    @invariant()
    def a_sync_read_tells_all_or_names_the_dead(self) -> None:
        if self.dead:
            with pytest.raises(NotAnswering) as caught:
                self.bus.sync_read(IDS, ct.ITEMS["Goal Position"]).all()
            assert set(caught.value.dxl_ids) == self.dead
        alive = [dxl_id for dxl_id in IDS if dxl_id not in self.dead]
        if alive:
            block = self.bus.sync_read(alive, ct.ITEMS["Goal Position"]).all()
            assert block == {dxl_id: self.goal[dxl_id] for dxl_id in alive}
            for dxl_id in alive:
                assert self.bus.read(dxl_id, ct.ITEMS["Current Limit"]) == self.limit[dxl_id]

    def teardown(self) -> None:
        if hasattr(self, "bus"):
            self.bus.close()
            self.hub.close()


TestBus = BusMachine.TestCase
TestBus.settings = settings(max_examples=25, stateful_step_count=25, deadline=None)
