"""Search steps, selected once: compiled if a C compiler was available, otherwise with NumPy.

The environment variable `PALPATE_KERNEL=off` selects numpy. Callers do not depend on the choice.
"""

import os
from collections.abc import Sequence
from typing import Protocol

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer import numpy_steps
from palpate.recognizer.approach import Facing, Rays
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.contact import NormalRange
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.interpretations import Interpretations, Query, TreeLevel
from palpate.recognizer.pose_region import Cells, Intervals, Regions, WitnessedCells
from palpate.recognizer.strip_trees import StripForest


class Steps(Protocol):
    """Innermost steps of a search; modules implement it."""

    def second_level(
        self,
        query: Query,
        normals: Sequence[NormalRange],
        most: int | None,
        *,
        modelled: bool,
        first: EdgeSet | None = None,
    ) -> TreeLevel:
        """Pairings of the second contact under each representative edge of the first, their `parent`.

        Unless they are `modelled`, the model test is left out. `first`: the first contact's edges, some of
        which only may represent their orbits; None: as the catalogue has them. Raises BudgetSpentError if
        more than `most` are to be looked at; None: there cannot be too many.
        """

    def third_level(
        self, query: Query, normals: Sequence[NormalRange], nodes: Interpretations, *, modelled: bool
    ) -> TreeLevel:
        """Pairings of the third contact under interpretations of two; otherwise like `second_level`."""

    def extend(
        self, query: Query, normals: NormalRange, cells: Cells, point: Floats, reach: Floats
    ) -> TreeLevel:
        """Pairings of the last contact under k cells, which are their `parent`.

        In the object's frame it lies within `reach` (k,) mm of `point` (k, 2). Raises BudgetSpentError where
        there are too many to look at.
        """

    def narrow(self, query: Query, paired: Ints, lo: Floats, hi: Floats) -> tuple[Floats, Floats]:
        """Intervals [lo, hi] (n,) of θ, narrowed to where two or three contacts fit their edges `paired`.

        `paired` (n, 2 or 3). Where nothing is left, lo > hi. The intervals may hold orientations that are
        ruled out, never the other way about.
        """

    def cut_cells(self, query: Query, nodes: Interpretations, intervals: Intervals) -> tuple[Cells, Ints]:
        """Cells of the intervals, empty ones left out; and which interval each belongs to."""

    def refine_intervals(
        self, query: Query, nodes: Interpretations, cells: Cells, parts: Ints
    ) -> tuple[Intervals, Ints]:
        """Intervals of cells (k,), each in `parts` (k,), as the model test leaves them; the cell of each."""

    def divide_cells(self, cells: Cells, lever_mm: float, parts: int) -> tuple[Cells, Ints]:
        """Each cell in `parts` along its longest side, orientations times the lever; of which cell."""

    def free_cells(self, evidence: Query, cells: Cells, skipped: Bools | None) -> Bools:
        """Cells (k,) that free paths (m) do not rule out altogether, except for those `skipped` (k, m)."""

    def enclose_stops(self, edges: EdgeSet, strips: StripForest, rays: Rays, facing: Facing) -> Floats:
        """Earliest, latest and furthest stop of r rays (mm), and least and greatest normal there: (5, r).

        Normals count from against the travel.
        """

    def sift_intervals(
        self, constraints: Constraints, intervals: Intervals, *, corners: bool
    ) -> WitnessedCells:
        """Cells of intervals that the free paths leave, with candidates in some; `corners`: more of them."""

    def sift_parts(self, constraints: Constraints, cells: Cells) -> WitnessedCells:
        """Cells in parts along their longest sides, those that the free paths leave, and candidates."""

    def can_be_verified(self, constraints: Constraints, cells: Cells) -> Bools:
        """Cells (k,) that may hold a configuration which satisfies all contacts; in the others none does."""

    def search_round(
        self, constraints: Constraints, found: WitnessedCells, *, refinable: bool
    ) -> tuple[Regions, Cells]:
        """Regions that are done, and the cells of those that are to be cut finer: none unless `refinable`."""

    def position_boxes(self, cells: Cells, origin_mm: Floats, anchor_mm: Floats) -> tuple[Floats, Floats]:
        """Smallest boxes (k, 2) in W of a point `origin_mm` (k, 2) of the object, rounded outward.

        The point, seen from the centroid, stands for the object's position.
        """


STEPS: Steps = numpy_steps
"""The steps that recognition takes."""

if os.environ.get("PALPATE_KERNEL") != "off":
    try:
        from palpate.recognizer import compiled_steps
    except ImportError as error:
        if error.name != "palpate.recognizer._kernel":
            raise
    else:
        STEPS = compiled_steps
