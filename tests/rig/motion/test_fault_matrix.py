"""A sample of the fault matrix: each row once, in one of the phases in which it must be noticed.

The small bench is enough for that, but where a bound on force or travel is that of the shipped bench's size.
`benchmarks/bench_fault_matrix.py` runs all cells on the whole bench, and with each guard removed.
"""

import random
from typing import Any

import pytest
from fault_matrix import Cell, problems, run_cell
from fault_page import table, table_of_page
from fault_rows import FAULTS

_WHOLE = ("something hard is pushed against a tip", "the computer stops, or palpate is killed")
_PHASES = ("approach", "touch", "free travel", "torque off")


def sample() -> list[Any]:
    """A cell of each row, and an array cut off at the beginning of a creep: nobody looked there once."""
    draw = random.Random(5)
    found = []
    for number, fault in enumerate(FAULTS):
        noticed = [phase for phase in _PHASES if phase in fault.noticed]
        phase = draw.choice(noticed or list(_PHASES))
        found.append(Cell("identify", phase, number, small=fault.name not in _WHOLE))
    cut = next(number for number, fault in enumerate(FAULTS) if fault.name == "an array's cable breaks")
    pushed = pytest.param(Cell("check --hold", "creep", cut, small=True), marks=pytest.mark.campaign)
    return [*found, Cell("calibrate", "creep", cut, small=True), pushed]


@pytest.mark.parametrize("cell", sample(), ids=str)
def test_a_cell_ends_as_its_row_says(cell: Cell) -> None:
    assert problems(cell, run_cell(cell)) == []


def test_the_page_has_the_rows_of_the_matrix() -> None:
    assert table_of_page() == table(), "write it anew: python benchmarks/bench_fault_matrix.py --page"
