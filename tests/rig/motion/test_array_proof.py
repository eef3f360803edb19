"""Arrays that are not where the rig file says, or hang, end a run before it presses hard."""

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palpate.base.errors import DeviceError, SafetyStop
from palpate.config import RigFile
from palpate.drivers.emulators import Taxels
from palpate.rig.bench import connect
from palpate.rig.emulated.devices import EmulatedRig, MockRig
from palpate.rig.motion.guarded_approach import carry_out_grip
from palpate.rig.motion.hand import Hand
from support.benches.rigs import firm_rig, small, small_objects
from support.benches.session import EmulatedSession, emulated_session
from support.campaign.sampling import sample

SHIPPED = Path(__file__).parents[3] / "src" / "palpate" / "config" / "rigs" / "bench.toml"


def a_grip(session: EmulatedSession, said: Callable[[Hand], None] = lambda _: None) -> None:
    """All fingers at once towards the middle."""
    with connect(session.bench_rig) as hand:
        hand.prepare()
        said(hand)
        carry_out_grip(hand, session.middle(), lambda _: None)
        said(hand)


def exchange(session: EmulatedSession, swap: Mapping[str, str]) -> EmulatedSession:
    """The same bench with arrays' cables in each other's ports."""
    assert session.bench_rig.mock is not None
    urls = {port: session.bench_rig.urls(swap.get(port, port)) for port in session.cables}
    devices = session.bench_rig.mock.rig.devices
    mock = MockRig(EmulatedRig(session.bench, devices), session.hub, session.clock, urls)
    return replace(session, bench_rig=replace(session.bench_rig, urls=urls.__getitem__, mock=mock))


def drawn(path: Path, seed: int) -> EmulatedSession:
    rig = RigFile.model_validate(tomllib.loads(small(path)))
    return emulated_session(seed=seed, rig=rig, objects=small_objects())


def hardest_n(session: EmulatedSession) -> float:
    return max(finger.hardest_n for finger in session.bench.fingers)


@pytest.mark.parametrize(
    ("path", "seed"), sample([(firm_rig(), 3), (firm_rig(), 8), (SHIPPED, 5)], [(firm_rig(), 3)])
)
def test_exchanged_arrays_press_no_harder_than_right_ones(path: Path, seed: int) -> None:
    right = drawn(path, seed)
    a_grip(right)
    wrong = exchange(drawn(path, seed), {"mock://f1": "mock://f2", "mock://f2": "mock://f1"})
    with pytest.raises(SafetyStop, match="until finger") as stop:
        a_grip(wrong)
    assert all(name in str(stop.value) for name in ("f1", "f2"))
    assert hardest_n(wrong) <= hardest_n(right) + 0.5
    assert not any(wrong.torque().values())


def test_every_array_that_has_touched_is_proven_once() -> None:
    session, proven = drawn(firm_rig(), 3), list[int]()
    a_grip(session, lambda hand: proven.append(len(hand.proven)))
    touched = sum(finger.hardest_n > 0 for finger in session.bench.fingers)
    assert proven == [0, touched]


def spoil(monkeypatch: pytest.MonkeyPatch, held: Callable[[float], float]) -> None:
    """Let the first array go on with the reading that it took at `held` (s) of now."""
    counts, known = Taxels.counts, dict[Taxels, dict[float, object]]()

    def spoilt(self: Taxels, force_n: object, now: float = 0.0) -> object:
        taken = known.setdefault(self, {})
        own = counts(self, force_n, now)  # type: ignore[arg-type]
        return taken.setdefault(held(now), own) if self is next(iter(known)) else own

    monkeypatch.setattr(Taxels, "counts", spoilt)


@pytest.mark.parametrize(
    ("held", "names"),
    [
        (lambda now: min(now, 2.2), "hangs"),
        (lambda _: 0.0, "hangs"),
        (lambda now: now // 0.03, "a second are new"),
    ],
    ids=["hung on its way", "hung from the start", "sampled at 33 Hz"],
)
def test_readings_that_repeat_end_a_run_before_it_presses(
    monkeypatch: pytest.MonkeyPatch, held: Callable[[float], float], names: str
) -> None:
    spoil(monkeypatch, held)
    session = drawn(firm_rig(), 3)
    with pytest.raises(DeviceError, match=names):
        a_grip(session)
    assert session.bench.fingers[0].hardest_n < 2.0
    assert not any(session.torque().values())


@pytest.mark.parametrize("seed", sample([3, 8], [3]))
def test_a_finger_whose_array_feels_nothing_is_stopped_by_its_currents(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """Its board is healthy and sends noise, but lies beside the rig."""
    right = drawn(firm_rig(), seed)
    a_grip(right)
    counts, known = Taxels.counts, list[Taxels]()

    def of_a_spare(self: Taxels, force_n: np.ndarray, now: float = 0.0) -> object:
        known.append(self)
        return counts(self, 0.0 * force_n if self is known[0] else force_n, now)

    monkeypatch.setattr(Taxels, "counts", of_a_spare)
    wrong = drawn(firm_rig(), seed)
    with pytest.raises(SafetyStop, match=r"is held: it needs .* its array feels nothing"):
        a_grip(wrong)
    assert hardest_n(wrong) <= hardest_n(right) + 1.0
    assert not any(wrong.torque().values())
