"""Pieces near a point: every piece with a place within reach is found; places are sampled here."""

import numpy as np
import pytest
from prepared_bits import drawn_catalogue

from palpate.recognizer import Catalogue, Finger

_SAMPLES = 60


@pytest.mark.parametrize("radius_mm", [0.0, 4.0])
@pytest.mark.parametrize("seed", [1, 2, pytest.param(3, marks=pytest.mark.campaign)])
def test_no_piece_within_reach_is_missed(seed: int, radius_mm: float) -> None:
    rng = np.random.default_rng(seed)
    catalogue = Catalogue(drawn_catalogue(seed, least_vertices=600))
    boundary = catalogue.boundary(Finger(radius_mm, 5.0))
    pieces, count = boundary.pieces, 300
    some = rng.integers(len(pieces), size=count)
    state = pieces.state[some]
    point = pieces.start[some] + rng.normal(0, 1, (count, 2)) * (radius_mm + 1)
    reach = rng.uniform(0, 3, count)
    owner, piece = boundary.pieces_near(state, point, reach)
    found = set(zip(owner.tolist(), piece.tolist(), strict=True))
    assert len(found) == len(owner)
    assert np.all(np.diff(owner * len(pieces) + piece) > 0)
    assert np.array_equal(pieces.state[piece], state[owner])
    within = 0
    for row in range(count):
        rows = np.arange(boundary.first_piece[state[row]], boundary.first_piece[state[row] + 1])
        share = np.linspace(0, 1, _SAMPLES)
        angle = pieces.normal_rad[rows, None] + share * pieces.turn_rad[rows, None]
        rim = radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=2)
        rel = point[row] - pieces.start[rows, None] - rim
        along = pieces.along[rows, None]
        foot = np.clip(np.sum(rel * along, axis=2), 0, pieces.length[rows, None])
        left = rel - foot[..., None] * along
        nearest = np.hypot(left[..., 0], left[..., 1]).min(axis=1)
        expected = rows[nearest <= reach[row] + pieces.off[rows]]
        within += len(expected)
        assert {(row, int(number)) for number in expected} <= found
    # It is a selection: what is left out is by far the most.
    assert within <= len(found) < 3 * within + count


def test_states_without_pieces_have_none() -> None:
    catalogue = Catalogue(drawn_catalogue(1)[:3])
    boundary = catalogue.boundary(Finger(4.0, 500.0))
    assert len(boundary.pieces) == 0
    owner, piece = boundary.pieces_near(np.array([0, 1]), np.zeros((2, 2)), np.full(2, 10.0))
    assert (len(owner), len(piece)) == (0, 0)
