"""A grip that is called decisive is: carried out for every hypothesis, it leaves one class."""

from pathlib import Path

import pytest
from decisive_grips import checked, drawn
from sampling import sample
from shapely_bench import SHIPPED_OBJECTS
from shared_files import SHARED_OUTLINES, needs_shared_outlines


@pytest.mark.parametrize("trials", sample([60, 150], [60]))
@pytest.mark.parametrize(
    ("path", "per_cent"),
    [(SHIPPED_OBJECTS, 5), pytest.param(SHARED_OUTLINES, 8, marks=needs_shared_outlines)],
    ids=["six", "outlines"],
)
def test_decisive_grips_decide(path: Path, per_cent: int, trials: int) -> None:
    decisive = 0
    for index in range(trials):
        trial = drawn(path, 11, index)
        if trial is None:
            continue
        decisive += 1
        found = checked(path, trial, 11, 3)
        assert found.outcomes >= 2 * found.hypotheses
        assert found.undecided == 0, f"trial {index}"
        assert found.unforeseen == 0, f"trial {index}"
    assert 100 * decisive >= per_cent * trials
