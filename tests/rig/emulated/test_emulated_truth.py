"""What emulated rigs draw: within what is declared, up to it, and apart from what seeds drew before."""

import math

import numpy as np
import pytest
from firm_rig import firm_rig
from repository import EXAMPLES

from palpate.base.errors import InputError
from palpate.config import ArmFingerConfig, SlideFingerConfig, load_rig
from palpate.drivers.emulators.mechanics import FingerTruth
from palpate.rig.emulated.devices import emulate
from palpate.rig.emulated.hidden_truth import dead_taxels, start_angles_rad

FRESH = load_rig(EXAMPLES / "fresh-rig.toml")
BENCH = load_rig(firm_rig())


def truths(seed: int) -> list[FingerTruth]:
    fingers = emulate(FRESH, None, seed).bench.fingers
    return [finger.truth for finger in fingers if isinstance(finger.truth, FingerTruth)]


def slides() -> list[SlideFingerConfig]:
    return [finger for finger in FRESH.fingers if isinstance(finger, SlideFingerConfig)]


def test_fresh_fingers_are_off_by_what_is_declared_and_no_more() -> None:
    """Distances from the drawing, as the file tells them: zero at Goal Position 0, mm per turn."""
    shares = []
    for seed in range(20):
        for spec, truth in zip(slides(), truths(seed), strict=True):
            per_turn = truth.mm_per_rad * 2 * math.pi
            at_zero = truth.zero_mm - per_turn / 2
            shares.append(
                (
                    (truth.tip_radius_mm - spec.tip.radius_mm) / spec.tip.radius_bound_mm,
                    math.degrees(truth.array_heading_rad) / spec.array.heading_bound_deg,
                    (at_zero - spec.slide.zero_mm) / spec.slide.zero_bound_mm,
                    (per_turn / spec.slide.mm_per_turn - 1) / spec.slide.mm_per_turn_spread,
                )
            )
    drawn = np.array(shares)
    assert np.abs(drawn).max() <= 1.0 + 1e-9
    assert (drawn.min(axis=0) < -0.8).all()
    assert (drawn.max(axis=0) > 0.8).all()
    assert np.abs(np.corrcoef(drawn.T) - np.eye(4)).max() < 0.4


def test_what_fresh_rigs_add_leaves_the_other_draws_alone() -> None:
    """The same file without the newer errors draws the same bases, headings, plays and stiffnesses."""
    assert FRESH.emulation is not None
    newer = ("tip_radius_error_mm", "array_heading_error_deg", "zero_error_mm", "mm_per_turn_error")
    plain = FRESH.emulation.model_copy(update=dict.fromkeys((*newer, "dead_taxels"), 0))
    without = emulate(FRESH.model_copy(update={"emulation": plain}), None, 3)
    for one, other in zip(emulate(FRESH, None, 3).bench.fingers, without.bench.fingers, strict=True):
        assert one.truth.base_mm == other.truth.base_mm
        assert one.truth.heading_rad == other.truth.heading_rad
        assert one.truth.stiffness_n_per_mm == other.truth.stiffness_n_per_mm
        assert one.truth.tip_radius_mm != other.truth.tip_radius_mm == 5.0
        assert one.array.description == other.array.description, "it believes what the drawing says"


def test_slides_start_where_the_host_takes_them_for_retracted() -> None:
    for spec, finger in zip(slides(), emulate(FRESH, None, 2).bench.fingers, strict=True):
        aim, slide = start_angles_rad(spec, FRESH)
        assert [servo.shaft_rad for servo in finger.servos] == [aim, slide]
        # 1 mm out of the retracted end by the file's numbers: 46 mm = 40 mm + 100 mm · 0.06 turns.
        assert slide + math.pi == pytest.approx(0.06 * 2 * math.pi)


def test_arms_draw_tips_and_arrays_too() -> None:
    rig = load_rig(EXAMPLES / "two-link-rig.toml")
    assert rig.emulation is not None
    off = {"tip_radius_error_mm": 0.3, "array_heading_error_deg": 2.0}
    changed = rig.model_copy(update={"emulation": rig.emulation.model_copy(update=off)})
    for spec, finger in zip(rig.fingers, emulate(changed, None, 1).bench.fingers, strict=True):
        assert isinstance(spec, ArmFingerConfig)
        assert 0 < abs(finger.truth.tip_radius_mm - spec.tip.radius_mm) <= 0.3
        assert 0 < abs(math.degrees(finger.truth.array_heading_rad) - spec.array.heading_deg) <= 2.0


def test_dead_taxels_are_where_touches_are_felt() -> None:
    d = emulate(FRESH, None, 0).bench.fingers[0].array.description
    # 20 columns over 270°: 13.5° apart, four and a half steps to either side are 60.75°.
    felt = {(row, col) for row in range(8) for col in range(6, 14)}
    assert set(dead_taxels(d, len(felt), np.random.default_rng(0))) == felt
    assert dead_taxels(d, 0, np.random.default_rng(0)) == ()
    with pytest.raises(InputError, match=r"^emulation.dead_taxels: is 65; an emulated array has 64 taxels"):
        dead_taxels(d, 65, np.random.default_rng(0))


def test_another_seed_is_another_array() -> None:
    ids = [
        finger.array.description.unique_id
        for seed in range(3)
        for finger in emulate(BENCH, None, seed).bench.fingers
    ]
    assert len(set(ids)) == 9
    assert ids[0][:8] == b"f1\0\0\0\0\0\0"
    assert {len(item) for item in ids} == {16}
    again = emulate(BENCH, None, 0).bench.fingers[0].array.description
    assert again.unique_id == ids[0]
