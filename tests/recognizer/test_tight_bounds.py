"""Bounds of what is left hold all that satisfies the contacts exactly, and hardly more."""

import numpy as np
import pytest
from shapely_bench import holding_truth
from verified_scenes import Scene, asked, drawn

from palpate.base.geometry.plane import rotate
from palpate.recognizer import Hypothesis, Recognition
from palpate.recognizer.hypotheses import enclosures
from palpate.recognizer.verification import Poses, verify
from palpate.recognizer.witness_search import position_boxes

_LEVER_MM = 40.0


def scenes(count: int) -> list[tuple[Scene, Recognition]]:
    """Grips of three fingers or more that leave few hypotheses."""
    found = []
    index = 0
    while len(found) < count:
        scene = drawn(5, index, ("memo",))
        index += 1
        if scene.touches >= 3 and len((answer := asked(scene)).hypotheses) <= 8:
            found.append((scene, answer))
    return found


def coarse_widths(item: Hypothesis) -> np.ndarray:
    """Widths (3,) of the box round a hypothesis's cells."""
    origin = np.tile(item.state.origin_mm, (len(item.cells), 1))
    lo, hi = position_boxes(item.cells, origin, item.constraints.anchor_mm)
    turn = float(item.cells.hi.max() - item.cells.lo.min())
    return np.append(hi.max(axis=0) - lo.min(axis=0), turn)


def widths(item: Hypothesis) -> np.ndarray:
    """Widths (3,) of a hypothesis's bounds."""
    bounds = (item.bounds.x_mm, item.bounds.y_mm, item.bounds.theta_rad)
    return np.array([hi - lo for lo, hi in bounds])


def test_whatever_satisfies_all_contacts_near_a_witness_is_within_the_bounds() -> None:
    rng = np.random.default_rng(0)
    checked = 0
    for _, answer in scenes(12):
        for item in answer.hypotheses:
            if not item.verified:
                continue
            # A walk from the witness on, over what can be reached through feasible configurations.
            at = np.tile([*item.witness_mm, item.configuration.theta_rad * _LEVER_MM], (40, 1))
            for step in range(40):
                going = at + rng.normal(size=at.shape) * rng.choice([0.02, 0.1, 0.4])
                held = verify(
                    answer.catalogue,
                    Poses(np.full(40, item.state_index), going[:, 2] / _LEVER_MM, going[:, :2]),
                    answer.contacts,
                    answer.anchor_mm,
                ).holds
                at[held] = going[held]
                if step % 4 == 3:
                    theta = at[:, 2] / _LEVER_MM
                    place = rotate(at[:, :2] - item.state.origin_mm, theta) + answer.anchor_mm
                    for value, (lo, hi) in zip(
                        (*place.T, theta),
                        (item.bounds.x_mm, item.bounds.y_mm, item.bounds.theta_rad),
                        strict=True,
                    ):
                        assert value.min() >= lo
                        assert value.max() <= hi
                    checked += 1
    assert checked > 100


def test_bounds_of_few_hypotheses_are_narrower_than_their_cells() -> None:
    ratio = []
    for scene, answer in scenes(30):
        for item in answer.hypotheses:
            assert np.all(widths(item) <= coarse_widths(item) + 1e-8)
        item = holding_truth(answer, scene.placed)
        assert item is not None
        ratio.append(widths(item) / coarse_widths(item))
    assert np.median(ratio, axis=0)[:2] == pytest.approx([0.9, 0.9], abs=0.1)
    assert np.min(ratio) < 0.8


def test_bounds_of_many_hypotheses_are_those_of_their_cells() -> None:
    index = 0
    while len((answer := asked(drawn(5, index, ("memo",)))).hypotheses) <= 32:
        index += 1
    hypotheses = answer.hypotheses
    lo, hi = enclosures(hypotheses.constraints, hypotheses.regions)
    cells, first = hypotheses.regions.cells, hypotheses.regions.first
    assert lo[:, 2] == pytest.approx(np.minimum.reduceat(cells.lo, first[:-1]))
    assert hi[:, 2] == pytest.approx(np.maximum.reduceat(cells.hi, first[:-1]))
