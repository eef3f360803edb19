"""Emulated tips of some length: what stops them, which rows of taxels feel it, and whole runs."""

import math

import numpy as np
import pytest
import shapely
from emulated_session import emulated_session
from quick_rig import small_rig
from sampling import sample
from upright_tips import Block, Stack, drawn_stack, model_of, slices

from palpate.base.vocabulary import IdentificationVerdict
from palpate.config import RigFile
from palpate.drivers.emulators.bench import facing_row_shares
from palpate.drivers.emulators.part import IN_PLACE
from palpate.drivers.emulators.skin import Skin
from palpate.recognizer import Catalogue
from palpate.rig.bench import connect
from palpate.rig.catalogue.reachability import overhangs_of
from palpate.rig.emulated.ground_truth import compare_answer
from palpate.rig.emulated.scene import Placement, outline_at
from palpate.rig.identification.loop import Identification, identify

FOOT = shapely.box(-30, -20, 30, 20)
BODY = shapely.box(-22, -14, 38, 8)
"""It stands back from the foot on three sides, and out over it on one."""
STEPPED = Stack((Block(FOOT, (0.0, 7.0)), Block(BODY, (7.0, 30.0))))
OTHER = Stack((Block(shapely.box(-26, -22, 26, 22), (0.0, 6.0)), Block(BODY, (6.0, 30.0))))


def rig_with(length_mm: float | None, true_mm: float | None) -> RigFile:
    """The small rig with tips of a length, as its file says and in truth."""
    data = small_rig().model_dump(exclude_unset=True)
    if true_mm is not None:
        data["emulation"]["tip_length_mm"] = true_mm
    for finger in data["fingers"]:
        finger["tip"]["length_mm"] = length_mm
    return RigFile.model_validate(data)


@pytest.mark.parametrize("seed", sample(range(20), range(5)))
def test_outlines_along_a_tip_are_those_of_the_solid(seed: int) -> None:
    rng = np.random.default_rng([71, seed])
    stack = drawn_stack(rng, leaning=False)
    height = float(rng.uniform(2, stack.top_mm))
    half = float(rng.uniform(0.5, height))
    model = model_of(stack)
    found = outline_at(Placement(model, model.states[0], 0.0, 0.0, 0.0), height, half)
    assert found is not None
    lines = slices(stack, (height - half, height + half))
    middles = shapely.points((found.start + found.end) / 2)
    assert shapely.distance(lines, middles).max() < 1e-6, "every edge is one of a slice"
    outer = shapely.polygonize(list(shapely.linestrings(np.stack([found.start, found.end], axis=1))))
    assert lines.difference(outer.buffer(1e-6)).is_empty, "and no slice is outside of them"
    assert found.z_mm is not None
    for middle, (low, high) in zip(middles, found.z_mm, strict=True):
        at = (low + high) / 2
        assert height - half - 1e-9 <= low <= high <= height + half + 1e-9
        own = [block.at(at) for block in stack.blocks if block.z_mm[0] <= at <= block.z_mm[1]]
        assert min(shape.boundary.distance(middle) for shape in own) < 1e-6 or high - low > 3.0


def test_a_disc_meets_one_section_as_before() -> None:
    model = model_of(STEPPED)
    placement = Placement(model, model.states[0], 3.0, 4.0, 0.3)
    disc = outline_at(placement, 10.0)
    assert disc is not None
    assert disc.z_mm is None
    assert len(disc.start) == 4
    assert outline_at(placement, 40.0, 5.0) is None
    low = outline_at(placement, 40.0, 12.0)
    assert low is not None, "its lower end is beside the body"


def test_rows_that_face_a_section_bear_its_force() -> None:
    rows = np.arange(3.0, 18.0, 2.0)
    shares = facing_row_shares(rows, np.array([[4.0, 7.0], [7.0, 16.0], [7.2, 8.8]]))
    assert shares.sum(axis=1) == pytest.approx(1.0)
    assert (shares[0] > 0).tolist() == [False, True, True, False, False, False, False, False]
    assert (shares[1] > 0).sum() == 5
    assert (shares[2] > 0).sum() == 1, "between two rows: the nearest one"


def test_a_foot_presses_at_its_height() -> None:
    model = model_of(STEPPED)
    outline = outline_at(Placement(model, model.states[0], 0.0, 0.0, 0.0), 10.0, 6.0)
    assert outline is not None
    press = Skin(5.0, 3.0).press(outline, np.array([-34.5, 0.0]), IN_PLACE, None)
    assert press is not None
    (force,) = press.on_part(np.array([-34.5, 0.0]), IN_PLACE, 10.0)
    assert force.height_mm == pytest.approx(5.5), "from 4 to 7 mm"
    assert press.load.force_n[0] < 0


def test_the_files_length_is_the_truth_unless_emulation_says_otherwise() -> None:
    halves = [
        emulated_session(rig=rig_with(said, true), empty=True).bench.fingers[0].truth.half_length_mm
        for said, true in ((None, None), (12.0, None), (12.0, 8.0), (None, 12.0), (None, 90.0))
    ]
    assert halves == [0.0, 6.0, 4.0, 6.0, 10.0]


def test_walls_that_are_not_upright_are_found() -> None:
    rig = rig_with(None, None)
    found = overhangs_of(rig, [model_of(STEPPED, "stepped"), model_of(Stack((Block(FOOT, (0, 30)),)), "box")])
    assert [item.object_name for item in found] == ["stepped"]
    assert found[0].out_mm == pytest.approx(math.hypot(8, 12))
    assert overhangs_of(rig_with(12.0, None), [model_of(STEPPED)]) == ()
    receding = Stack((Block(FOOT, (0.0, 12.0)), Block(shapely.box(-22, -14, 18, 8), (12.0, 30.0))))
    assert overhangs_of(rig, [model_of(receding)]) == (), "nothing stands out of the section at 10 mm"


def ended(length_mm: float | None, seed: int) -> tuple[Identification, bool]:
    """A run with tips that are 12 mm long in truth, and whether its answer holds the truth."""
    models = [model_of(STEPPED, "stepped"), model_of(OTHER, "other")]
    placement = Placement(models[0], models[0].states[0], 4.0, -3.0, 0.7 + seed)
    session = emulated_session(seed=seed, rig=rig_with(length_mm, 12.0), placement=placement)
    with connect(session.bench_rig) as hand:
        hand.prepare()
        result = identify(hand, Catalogue(models))
    assert not any(session.torque().values())
    left = result.recognition.hypotheses if result.recognition else ()
    return result, compare_answer(placement, left).inside_bounds


@pytest.mark.parametrize("seed", sample(range(6), range(2)))
def test_a_stepped_part_is_identified_by_tips_whose_length_is_known(seed: int) -> None:
    result, inside = ended(12.0, seed)
    assert result.outcome is IdentificationVerdict.IDENTIFIED
    assert inside


def test_without_the_length_the_truth_is_lost() -> None:
    _, inside = ended(None, 0)
    assert not inside
