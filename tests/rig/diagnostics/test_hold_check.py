"""What force a part holds, measured by pushing it: never more than it does, gently, and torque off."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from emulated_session import EmulatedSession, emulated_session
from firm_rig import firm_rig
from hypothesis import given, settings
from hypothesis import strategies as st
from json_schema import violations
from quick_rig import small_objects, small_rig

import palpate
from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.config.diagnosis_results import HoldCheckOut
from palpate.config.emulation import EmulatedPartConfig
from palpate.config.schema import schema_text
from palpate.rig.bench import connect
from palpate.rig.diagnostics.hold_check import check_hold, least_threshold_n, with_light_touch
from palpate.rig.motion.creep import is_sliding

SOFT_N_PER_MM = 2.4


def bench_with(
    seed: int, *, engine: str = "quasi-static", empty: bool = False, **part: float
) -> EmulatedSession:
    """Two fingers of the small bench and a part that slides, unless it is "still"."""
    rig = small_rig()
    assert rig.emulation is not None
    closing = rig.closing.model_copy(update={"approach_speed_mm_s": 30.0, "sample_rate_hz": 125.0})
    slides = EmulatedPartConfig.model_validate({"engine": engine, **part})
    emulation = rig.emulation.model_copy(update={"part": slides})
    changes = {"closing": closing, "emulation": emulation, "fingers": rig.fingers[:2]}
    rig = rig.model_copy(update=changes)
    return emulated_session(seed=seed, rig=rig, objects=small_objects(), empty=empty)


def held(session: EmulatedSession) -> HoldCheckOut:
    with connect(session.bench_rig) as hand:
        hand.prepare()
        quietest_n = least_threshold_n(hand)
    rig = with_light_touch(session.rig, quietest_n)
    with connect(replace(session.bench_rig, rig=rig)) as hand:
        hand.prepare()
        return check_hold(hand)


@pytest.mark.parametrize(
    ("seed", "part"),
    [
        pytest.param(0, {"mass_kg": 0.15, "friction": 0.3, "tip_friction": 0.3}, id="150 g"),
        pytest.param(
            1,
            {"mass_kg": 0.7, "friction": 0.25, "tip_friction": 0.6},
            id="700 g",
            marks=pytest.mark.campaign,
        ),
        pytest.param(
            2, {"mass_kg": 0.06, "friction": 0.2, "tip_friction": 0.0}, id="60 g", marks=pytest.mark.campaign
        ),
    ],
)
def test_a_part_holds_what_is_said_and_is_hardly_moved(seed: int, part: dict[str, float]) -> None:
    session = bench_with(seed, **part)
    out = held(session)
    slip_n = part["mass_kg"] * part["friction"] * 9.80665
    assert 0.25 * slip_n < out.part_holds_n < slip_n
    assert out.least_n <= out.part_holds_n
    assert out.slid
    assert [item.finger for item in out.fingers] == ["f1", "f2"]
    assert all(item.moved_mm < 1.0 for item in out.fingers)
    moved = session.bench.part.displacement
    assert np.hypot(*moved.shift_mm) < out.moved_mm + 0.2
    assert max(finger.hardest_n for finger in session.bench.fingers) < 1.1 * slip_n
    assert not any(session.torque().values())


@pytest.mark.campaign
def test_a_part_that_stands_is_pushed_no_harder_than_is_said() -> None:
    session = bench_with(3, engine="still")
    out = held(session)
    assert not out.slid
    assert 2.0 < out.part_holds_n <= out.largest_n == 3.0
    assert max(finger.hardest_n for finger in session.bench.fingers) < 1.3 * out.largest_n


@pytest.mark.campaign
def test_the_command_on_the_shipped_bench(tmp_path: Path) -> None:
    part = '[emulation.part]\nengine = "quasi-static"\nmass_kg = 0.15\nfriction = 0.3\n\n[[fingers]]'
    text = firm_rig().read_text(encoding="utf-8").replace("[[fingers]]", part, 1)
    rig = tmp_path / "rig.toml"
    rig.write_text(text, encoding="utf-8")
    said: list[str] = []
    found = palpate.open_rig(rig, seed=7).check(hold=True, progress=said.append)
    assert found.well
    assert found.result.hold is not None
    assert 0.2 < found.result.hold.part_holds_n < 0.44
    assert violations(json.loads(found.to_json()), json.loads(schema_text("check"))) == []
    assert said[-4:] == ["  looking for the part", *(f"  pushing with finger f{k}" for k in (1, 2, 3))]


@pytest.mark.campaign
def test_an_empty_table_is_one_line() -> None:
    session = bench_with(0, empty=True)
    with pytest.raises(InputError, match="no part was found that is 20 mm wide") as said:
        held(session)
    assert "\n" not in str(said.value)
    assert not any(session.torque().values())


@settings(max_examples=50)
@given(
    stiffness=st.floats(SOFT_N_PER_MM, 4.0),
    holds_n=st.floats(0.05, 2.0),
    play_mm=st.floats(0.0, 0.1),
    seed=st.integers(0, 1000),
)
def test_sliding_is_seen_once_the_force_stays_and_not_before(
    stiffness: float, holds_n: float, play_mm: float, seed: int
) -> None:
    """A skin behind a little play, read in steps of an encoder, with noise."""
    travel = np.arange(0.0, 2.0, 0.008)
    noise = np.random.default_rng(seed).normal(0.0, 0.01, len(travel))
    read: Floats = np.round(travel / 0.024) * 0.024
    force = np.minimum(0.06 + stiffness * np.maximum(travel - play_mm, 0.0), holds_n) + noise
    seen = [n for n in range(1, len(travel)) if is_sliding(read[:n], force[:n], SOFT_N_PER_MM)]
    slides_mm = play_mm + max(holds_n - 0.06, 0.0) / stiffness
    assert travel[seen[0]] > slides_mm
    assert travel[seen[0]] < slides_mm + 0.6
