"""Touches: light, guarded, with late frames, slow arrays, times of samples."""

import math
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from palpate.base.geometry.plane import distance_range
from palpate.config import ObjectsFile, RigFile, load_objects, load_rig, shipped_objects
from palpate.drivers.dynamixel.guarded_motion import MoveEnd
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.transport.wire import Device, Emission
from palpate.rig.bench import connect
from palpate.rig.contact_peak import expected_peak_n, quickest_mm_s
from palpate.rig.motion.array_guard import SampleTimes
from palpate.rig.motion.finger_movers import TipMover
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.load_meter import TouchStage
from palpate.rig.motion.touch import Touch
from support.benches.late_grips import ROWS, run_grip
from support.benches.rigs import firm_rig, small, small_objects, small_parts
from support.benches.session import EmulatedSession, emulated_session, run_checked, shape_of, small_session
from support.campaign.sampling import sample
from support.commands.command import Here
from support.commands.repository import EXAMPLES, SHARED_OUTLINES, needs_shared_outlines

# ----------------------------------------------------------------------------------------------------
# A light touch: fast through free space, slow where the part may be, off it at once, as hard as stated.

STIFFER = 1.2
"""A tip may be so much stiffer than the rig file says, and its array read so much more."""


def light(rig: RigFile, **changes: float) -> RigFile:
    changes = {"search_speed_mm_s": 5.0, "touch_speed_mm_s": 2.0, "contact_force_n": 0.1} | changes
    return rig.model_copy(update={"closing": rig.closing.model_copy(update=changes)})


def gripped(session: EmulatedSession, fast_mm: float) -> tuple[list[Touch], float]:
    """All fingers through the middle, fast for so long; and how long that took."""
    grip = [replace(item, fast_mm=fast_mm) for item in session.middle()]
    with connect(session.bench_rig) as hand:
        begun = session.clock.now()
        touches = session.grip(hand, grip)
        return touches, session.clock.now() - begun


@dataclass(frozen=True)
class Gripped:
    """A grip that was slow all the way, with whose session, and how long it took."""

    session: EmulatedSession
    touches: list[Touch]
    seconds: float


@pytest.fixture(scope="module")
def slow_grip() -> Callable[[Path], Gripped]:
    """Such a grip of a rig, which is made once."""

    @cache
    def grip_of(path: Path) -> Gripped:
        session = emulated_session(seed=7, rig=light(load_rig(path)))
        return Gripped(session, *gripped(session, 0.0))

    return grip_of


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(firm_rig(), id="slides"),
        pytest.param(EXAMPLES / "two-link-rig.toml", id="arms", marks=pytest.mark.campaign),
    ],
)
def test_a_finger_is_slow_where_it_may_meet_the_part(
    path: Path, slow_grip: Callable[[Path], Gripped]
) -> None:
    rig, before = light(load_rig(path)), slow_grip(path)
    sessions = [before.session, emulated_session(seed=7, rig=rig)]
    slow, slow_s = before.touches, before.seconds
    way = min(float(np.hypot(*np.subtract(t.contact.end_mm, t.contact.start_mm))) for t in slow)
    fast, fast_s = gripped(sessions[1], way - 10.0)
    assert fast_s < 0.9 * slow_s
    for session, touches in zip(sessions, (slow, fast), strict=True):
        hardest = max(expected_peak_n(rig, speed) for speed in (5.0, 2.0))
        assert max(finger.hardest_n for finger in session.bench.fingers) < STIFFER * hardest + 0.05
        assert any(touch.contact.touched for touch in touches)
    for one, other in zip(slow, fast, strict=True):
        assert one.contact.touched == other.contact.touched
        apart = np.hypot(*np.subtract(one.contact.end_mm, other.contact.end_mm))
        assert apart < one.contact.position_bound_mm + other.contact.position_bound_mm


def test_every_touch_says_what_it_loaded_the_part_with(slow_grip: Callable[[Path], Gripped]) -> None:
    grip = slow_grip(firm_rig())
    for touch, finger in zip(grip.touches, grip.session.bench.fingers, strict=True):
        assert [load.stage for load in touch.loads] == [TouchStage.QUICK, TouchStage.SLOW]
        peak = max(load.peak_force_n for load in touch.loads)
        assert peak == pytest.approx(finger.hardest_n, rel=0.25)
        assert all(0.0 < load.travel_mm < 0.3 for load in touch.loads)


def test_a_finger_that_has_touched_does_not_press_while_others_are_under_way() -> None:
    """The finger whose way is longest comes seconds later: until then the others have left the part."""
    session = emulated_session(seed=7, rig=light(load_rig(firm_rig())))
    grip = [replace(item, fast_mm=60.0 * (index > 0)) for index, item in enumerate(session.middle())]
    pressed = [0.0] * len(grip)
    last = [session.clock.now()]

    def look() -> None:
        now = session.clock.now()
        for index, finger in enumerate(session.bench.fingers):
            pressed[index] += (now - last[0]) * (finger.press is not None)
        last[0] = now

    session.clock.on_tick = look
    with connect(session.bench_rig) as hand:
        session.grip(hand, grip)
    assert max(pressed[1:]) < 2.0


def test_the_expected_peak_grows_with_speed_and_threshold() -> None:
    rig = load_rig(firm_rig())
    peaks = [expected_peak_n(light(rig, contact_force_n=force), 5.0) for force in (0.05, 0.1, 0.3)]
    assert peaks == sorted(peaks)
    assert expected_peak_n(rig, 20.0) == pytest.approx(2.85, abs=0.01)  # as docs/rig-file.md has it
    assert expected_peak_n(light(rig), 5.0) == pytest.approx(0.34, abs=0.01)


def test_the_quickest_speed_presses_with_no_more_than_is_asked() -> None:
    rig = light(load_rig(firm_rig()), search_speed_mm_s=20.0, touch_speed_mm_s=2.0)
    for peak_n in (0.2, 0.34, 1.0, 2.0):
        speed = quickest_mm_s(rig, peak_n)
        assert expected_peak_n(rig, speed) <= peak_n < expected_peak_n(rig, speed + 0.1)
    assert quickest_mm_s(rig, 100.0) == 20.0, "no quicker than the search"
    assert quickest_mm_s(rig, 0.0) == 2.0, "no slower than a contact is measured"


@pytest.mark.parametrize("rate_hz", sample([100.0, 250.0, 500.0], [100.0]))
def test_a_finger_has_slowed_down_where_free_space_ends_and_not_long_before(rate_hz: float) -> None:
    """Whatever the time between two looks at the servos."""
    rig = light(load_rig(firm_rig()), sample_rate_hz=rate_hz)
    touches, _ = gripped(emulated_session(seed=7, rig=rig), 40.0)
    for touch in touches:
        trace = touch.trace
        assert trace is not None
        speed = np.gradient(trace.travel_mm, trace.time_s)
        on_way = (trace.time_s < trace.time_s[np.argmax(trace.travel_mm)]) & (trace.travel_mm > 20.0)
        slow = trace.travel_mm[on_way & (speed < 1.5 * 5.0)]
        assert 38.0 < slow.min() < 40.6


def test_a_miss_says_nothing_of_the_way_from_where_something_was_felt(
    slow_grip: Callable[[Path], Gripped],
) -> None:
    """A finger that ends its way pressing on the part, with less than counts as a contact."""
    rig = light(load_rig(firm_rig()), contact_force_n=2.0)
    found = slow_grip(firm_rig()).touches
    session = emulated_session(seed=7, rig=rig)
    ways = [math.dist(touch.contact.start_mm, touch.contact.end_mm) for touch in found]
    grip = [replace(item, travel_mm=way + 0.3) for item, way in zip(session.middle(), ways, strict=True)]
    with connect(session.bench_rig) as hand:
        missed = session.grip(hand, grip)
    assert max(finger.hardest_n for finger in session.bench.fingers) > 0.3
    for touch, way in zip(missed, ways, strict=True):
        assert not touch.contact.touched
        assert way - 1.0 < math.dist(touch.contact.start_mm, touch.contact.end_mm) < way + 0.05


# ----------------------------------------------------------------------------------------------------
# What a closing claims is true of the bench: places, normals, free ways, forces, distances of fingers.


def gaps_mm(session: EmulatedSession) -> list[float]:
    """True free space between every two fingers, as discs swept from base to tip."""
    ends = [(np.array([f.truth.base_mm]), np.array([f.centre_mm]), f.truth) for f in session.bench.fingers]
    gaps = []
    for i, (base, tip, one) in enumerate(ends):
        for other_base, other_tip, other in ends[:i]:
            apart, _ = distance_range(base, tip, other_base, other_tip)
            gaps.append(float(apart[0]) - one.tip_radius_mm - other.tip_radius_mm)
    return gaps


@pytest.mark.parametrize("number", sample([2, 3], [2]))
def test_every_touch_is_within_its_bounds(number: int) -> None:
    """Each shipped object at a drawn place, gripped at random."""
    objects = load_objects(shipped_objects())
    one = ObjectsFile((objects.objects[number],))
    touches = run_checked(emulated_session(seed=100 + number, objects=one), 2, number)
    assert sum(touch.contact.touched for touch in touches) >= 3


@pytest.mark.slow
@needs_shared_outlines
@pytest.mark.parametrize("seed", sample(range(2), []))
def test_every_touch_on_real_parts_is_within_its_bounds(seed: int) -> None:
    touches = run_checked(emulated_session(seed=seed, objects=load_objects(SHARED_OUTLINES)), 2, seed)
    assert touches


def test_an_empty_table_is_missed_and_fingers_stay_apart() -> None:
    session = small_session(empty=True)
    closest = [math.inf]
    session.clock.on_tick = lambda: closest.append(min(closest.pop(), *gaps_mm(session)))
    with connect(session.bench_rig) as hand:
        touches = session.grip(hand, session.middle())
    assert [touch.contact.touched for touch in touches] == [False] * 3
    assert all(touch.patch is None for touch in touches)
    assert session.rig.closing.clearance_mm - 2.0 <= closest[0] <= session.rig.closing.clearance_mm + 2.0
    for touch in touches:
        short = np.hypot(*touch.contact.end_mm)
        assert 5.0 < short < 20.0, "they stopped on their ways, short of the middle"


def test_fingers_wait_outside_the_workspace_between_grips() -> None:
    session = small_session(seed=3)
    with connect(session.bench_rig) as hand:
        session.grip(hand, session.middle())
        for finger in session.bench.fingers:
            outside = session.rig.workspace.radius_mm + finger.truth.tip_radius_mm
            assert np.hypot(*finger.centre_mm) >= outside - 1.5
        assert all(session.torque().values())
    assert not any(session.torque().values())


# ----------------------------------------------------------------------------------------------------
# Frames that come late: what a grip claims does not rest on when its frames arrived.

BY_NAME = {row.name: row for row in ROWS}
GRIPS = (
    ("fast", "16 ms and stalls everywhere", 3),
    ("fast", "frames late by 0 to 80 ms", 7),
    ("fast", "nothing", 13),  # a finger that goes back drags the part along
)
STALL_S = 0.13
"""Less than the silence after which an array counts as lost."""


@pytest.mark.parametrize(("kind", "name", "seed"), sample(GRIPS, GRIPS[1:2]))
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


@pytest.mark.campaign
def test_servos_hear_from_the_host_while_arrays_answer_late() -> None:
    """Each array takes 110 ms to confirm that it streams; Bus Watchdog waits for 0.5 s."""
    found = run_grip("fast", BY_NAME["frames late by 110 ms, touched at 15 mm/s"], 0)
    assert not isinstance(found, str), found
    assert "work" in found  # a grip that is begun again has no trace


# ----------------------------------------------------------------------------------------------------
# A grip with arrays that send seldom: servos hear from the host often enough all the same.


@pytest.mark.slow
def test_a_grip_with_ten_frames_a_second(tmp_path: Path, here: Here) -> None:
    """Bus Watchdog is armed with 0.5 s: less than a tare takes here, or five frames."""
    text = small(firm_rig())
    text = text.replace("sample_rate_hz = 250.0", "sample_rate_hz = 10.0")
    text = text.replace("approach_speed_mm_s = 20.0", "approach_speed_mm_s = 10.0")
    text = text.replace("max_grips = 12", "max_grips = 1")
    Path("rig.toml").write_text(text, encoding="utf-8")
    words = ["--rig", "rig.toml", "--objects", small_parts(tmp_path), "--seed", 7, "--json"]
    done = here("identify", *words)
    assert done.code in (0, 1), done.err
    assert done.json["grips"] == 1
    assert done.json["touches"] == 3
    assert "heard nothing" not in done.err


# ----------------------------------------------------------------------------------------------------
# Sample times: whatever adapters do, a frame was sampled between the bounds that are stated for it.

COUNTS = np.zeros((2, 3), np.uint16)
ON_WIRE_S = 0.003


def arrivals(
    sampled_s: np.ndarray, timer_s: float, phase: float, stalls: list[tuple[float, float]]
) -> np.ndarray:
    """When frames reach the host: by a latency timer's next tick, after stalls [begin, end), in order."""
    found = sampled_s + ON_WIRE_S
    if timer_s:
        found = (np.ceil(found / timer_s - phase) + phase) * timer_s
    for begin, end in stalls:
        found = np.where((found >= begin) & (found < end), end, found)
    result: np.ndarray = np.maximum.accumulate(found)
    return result


def bounds_of(
    sampled_s: np.ndarray, arrived_s: np.ndarray, *, clock: float, rate: float, look_s: float, asked_s: float
) -> tuple[np.ndarray, np.ndarray, list[tuple[int, float]]]:
    """Earliest and latest instants of frames, and how far `sampled_s` was after each look, by frames read."""
    times = SampleTimes(asked_s)
    earliest, latest, reached = [], [], []
    read, looked_s = 0, 0.0
    while read < len(sampled_s):
        looked_s += look_s
        upto = int(np.searchsorted(arrived_s, looked_s, side="right"))
        if upto == read:
            continue
        frames = [
            TactileFrame(k, float(clock + sampled_s[k] * rate), looked_s, COUNTS) for k in range(read, upto)
        ]
        found = np.array(times.latest_s(frames))
        earliest.extend((found - times.spread_s).tolist())
        latest.extend(found.tolist())
        reached.append((upto, times.sampled_s))
        read = upto
    return np.array(earliest), np.array(latest), reached


@given(
    period_s=st.sampled_from([0.004, 0.008, 0.01, 0.016, 0.033]),
    timer_s=st.sampled_from([0.0, 0.001, 0.016]),
    phase=st.floats(0.0, 1.0),
    look_s=st.floats(0.002, 0.03),
    clock=st.floats(-100.0, 1e5),
    stalls=st.lists(st.tuples(st.floats(0.0, 8.0), st.floats(0.01, 0.14)), max_size=8),
)
def test_a_frame_was_sampled_between_its_bounds(
    period_s: float,
    timer_s: float,
    phase: float,
    look_s: float,
    clock: float,
    stalls: list[tuple[float, float]],
) -> None:
    sampled = 0.1 + period_s * np.arange(1, 1500)
    arrived = arrivals(sampled, timer_s, phase, [(begin, begin + lasts) for begin, lasts in stalls])
    earliest, latest, reached = bounds_of(sampled, arrived, clock=clock, rate=1.0, look_s=look_s, asked_s=0.1)
    assert (earliest <= sampled + 1e-9).all()
    assert (latest >= sampled - 1e-9).all()
    for read, upto_s in reached:
        assert upto_s <= sampled[read - 1] + 1e-9


@pytest.mark.parametrize("rate", [0.98, 0.998, 1.002, 1.02])
def test_a_clock_that_is_wrong_shifts_bounds_by_little(rate: float) -> None:
    sampled = 0.1 + 0.004 * np.arange(1, 5000)
    arrived = arrivals(sampled, 0.016, 0.3, [])
    earliest, latest, _ = bounds_of(sampled, arrived, clock=7.0, rate=rate, look_s=0.004, asked_s=0.1)
    slack_s = 128 * 0.004 * abs(rate - 1) + 1e-9
    assert (earliest <= sampled + slack_s).all()
    assert (latest >= sampled - slack_s).all()


def test_delays_that_grow_after_the_start_widen_the_bounds() -> None:
    sampled = 0.1 + 0.004 * np.arange(1, 1000)
    arrived = sampled + ON_WIRE_S + np.where(sampled > 1.0, 0.06, 0.0)
    earliest, latest, _ = bounds_of(sampled, arrived, clock=0.0, rate=1.0, look_s=0.004, asked_s=0.1)
    assert (earliest <= sampled + 1e-9).all()
    assert (latest >= sampled - 1e-9).all()
    assert (latest - earliest)[100] < 0.02
    assert 0.06 < (latest - earliest)[-1] < 0.08


def test_before_the_first_frame_nothing_is_known() -> None:
    times = SampleTimes(3.0)
    assert math.isinf(times.spread_s)
    assert times.sampled_s == -math.inf
