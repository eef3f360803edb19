"""Frames that come late: what a grip claims does not rest on when its frames arrived."""

import math
import tomllib
from collections.abc import Sequence

import pytest
import shapely
from emulated_session import EmulatedSession, emulated_session, shape_of
from firm_rig import firm_rig
from late_grips import ROWS, run_grip
from quick_rig import small, small_objects
from sampling import sample

from palpate.config import RigFile
from palpate.drivers.dynamixel.guarded_motion import MoveEnd
from palpate.drivers.transport.wire import Device, Emission
from palpate.rig.bench import connect
from palpate.rig.motion.finger_movers import TipMover
from palpate.rig.motion.guarded_approach import GripPhase

BY_NAME = {row.name: row for row in ROWS}
GRIPS = (
    ("fast", "16 ms and stalls everywhere", 3),
    ("fast", "frames late by 0 to 80 ms", 7),
    ("fast", "nothing", 13),  # a finger that goes back drags the part along
)
STALL_S = 0.13
"""Less than the silence after which an array counts as lost."""


@pytest.mark.parametrize(("kind", "name", "seed"), sample(GRIPS, GRIPS[1:]))
def test_claims_of_a_grip_hold_behind_adapters_as_bought(kind: str, name: str, seed: int) -> None:
    found = run_grip(kind, BY_NAME[name], seed)
    assert not isinstance(found, str), found
    assert {claim: share for claim, share in found.items() if share > 1} == {}
    assert {"force", "work", "contact", "after: shift"} <= set(found)


class Hub:
    """A device behind a hub that passes nothing on until `until_s`."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._held: list[Emission] = []
        self.until_s = -math.inf

    def feed(self, data: bytes, now: float) -> list[Emission]:
        return self._passed(self._device.feed(data, now), now)

    def poll(self, now: float) -> list[Emission]:
        return self._passed(self._device.poll(now), now)

    def next_due(self) -> float | None:
        own = self._device.next_due()
        return None if own is None else max(own, self.until_s)

    def _passed(self, emissions: Sequence[Emission], now: float) -> list[Emission]:
        self._held += emissions
        if now < self.until_s:
            return []
        passed, self._held = [(max(at, self.until_s), data) for at, data in self._held], []
        return passed


def stall_at_contacts(session: EmulatedSession, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the hub of an array stall as soon as the host has noticed a slow touch."""
    hubs = {}
    for spec in session.rig.fingers:
        cable = session.cables[spec.array.port]
        cable._device = hubs[spec.name] = Hub(cable._device)
    sense = TipMover.sense

    def noticed(mover: TipMover, now: float) -> MoveEnd | None:
        end = sense(mover, now)
        if end is MoveEnd.CONTACT and session.stages[-1] is GripPhase.TOUCHING:
            hubs[mover.finger.name].until_s = session.clock.now() + STALL_S
        return end

    monkeypatch.setattr(TipMover, "sense", noticed)


def test_a_contact_is_measured_with_frames_of_the_tip_at_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """The hub stalls while the tip is on its way to rest: frames of that come after it has settled."""
    described = tomllib.loads(small(firm_rig()))
    described["closing"]["touch_speed_mm_s"] = 15.0
    described["emulation"]["bus_adapter"] = {"latency_ms": 16}
    rig = RigFile.model_validate(described)
    session = emulated_session(seed=0, rig=rig, objects=small_objects())
    stall_at_contacts(session, monkeypatch)
    true_n: list[float] = []

    def tell(phase: GripPhase) -> None:
        session.stages.append(phase)
        if phase is GripPhase.RETRACTING:
            presses = [finger.press for finger in session.bench.fingers]
            true_n.extend(0.0 if press is None else float(press.on_skin_n.sum()) for press in presses)

    with connect(session.bench_rig) as hand:
        touches = session.grip(hand, session.middle(), tell)
    assert session.placement is not None
    boundary = shape_of(session.placement).boundary
    assert all(touch.contact.touched for touch in touches)
    for touch in touches:
        contact, patch = touch.contact, touch.patch
        off_mm = abs(boundary.distance(shapely.Point(contact.end_mm)) - contact.finger.tip_radius_mm)
        assert off_mm <= contact.position_bound_mm
        assert patch is not None
        assert abs(patch.force_n - true_n[touch.finger_index]) <= patch.force_bound_n


def test_servos_hear_from_the_host_while_arrays_answer_late() -> None:
    """Each array takes 110 ms to confirm that it streams; Bus Watchdog waits for 0.5 s."""
    found = run_grip("fast", BY_NAME["frames late by 110 ms, touched at 15 mm/s"], 0)
    assert not isinstance(found, str), found
    assert "work" in found  # a grip that is begun again has no trace
