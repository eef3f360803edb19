"""Free-path evidence: where a straight approach must stop and may stop, over all configurations in a cell.

Used backwards as evidence (the path before a contact was free; a missed approach was free all along) and
forwards as prediction (where will the finger stop?), so that planner and recogniser cannot disagree. If no
point of the object is further than ρ from where the cell's middle configuration puts it, the finger cannot
stop before it comes within ρ of the middle outline, and cannot pass a point that lies deeper than ρ in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.compiled import KERNEL
from palpate.recognizer.compiled_sweep import cells_left_free, stops
from palpate.recognizer.contact import Contact
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.rays import Approach, Rays, rays_of, split_rays
from palpate.recognizer.region import Cells
from palpate.recognizer.strip_trees import StripForest
from palpate.recognizer.swept_edges import capsules_of

__all__ = ["StopIntervals", "free_path_test", "free_paths_of", "sweep"]


@dataclass(frozen=True, eq=False)
class StopIntervals:
    """For k cells and m approaches: the finger stops after a travel within [`earliest`, `latest`] (k, m) mm.

    `earliest` is infinite where nothing can be met; `latest` is infinite where the finger may miss.
    """

    earliest: Floats
    latest: Floats


def sweep(
    catalogue: Catalogue,
    cells: Cells,
    anchor_mm: Floats,
    approaches: Sequence[Approach],
    skipped: Bools | None = None,
) -> StopIntervals:
    """Enclose the travel at which the object stops the finger, for k cells, all of each, and m approaches.

    Those `skipped` (k, m) are not looked at and come back as infinite.
    """
    shape = (len(cells), len(approaches))
    if KERNEL is not None:
        outlines = [catalogue.outlines(approach.finger) for approach in approaches]
        return StopIntervals(*stops(KERNEL, outlines, cells, anchor_mm, approaches, skipped))
    earliest, latest = np.full(shape, np.inf), np.full(shape, np.inf)
    for finger in dict.fromkeys(approach.finger for approach in approaches):
        edges = catalogue.outlines(finger)
        columns = [k for k, approach in enumerate(approaches) if approach.finger == finger]
        rays = rays_of(edges, cells, anchor_mm, [approaches[k] for k in columns])
        row, column = np.divmod(np.arange(len(rays.state)), len(columns))
        column = np.array(columns)[column]
        if skipped is not None:
            wanted = np.flatnonzero(~skipped[row, column])
            rays, row, column = rays.select(wanted), row[wanted], column[wanted]
        if len(row):
            earliest[row, column], latest[row, column] = _stops(edges, catalogue.outline_strips(finger), rays)
    return StopIntervals(earliest, latest)


def free_path_test(
    catalogue: Catalogue,
    cells: Cells,
    anchor_mm: Floats,
    contacts: Sequence[Contact],
    skipped: Bools | None = None,
) -> Bools:
    """Cells (k,) that the free paths of m contacts, and of misses, do not rule out altogether.

    A cell goes only if every configuration in it would have stopped a finger before the end of its path.
    `skipped` (k, m): paths that are no evidence for a cell, or that are known to leave it.
    """
    paths = free_paths_of(contacts)
    if KERNEL is not None:
        outlines = [catalogue.outlines(path.finger) for path in paths]
        return cells_left_free(KERNEL, outlines, cells, anchor_mm, paths, skipped)
    travel = np.array([path.travel_mm for path in paths])
    result: Bools = np.all(sweep(catalogue, cells, anchor_mm, paths, skipped).latest >= travel, axis=1)
    return result


def free_paths_of(contacts: Sequence[Contact]) -> list[Approach]:
    """Paths of contacts, and of misses, that were free."""
    return [
        Approach(
            contact.finger,
            contact.start_mm,
            contact.direction_rad,
            contact.travel_mm,
            contact.free_path_bound_mm,
        )
        for contact in contacts
    ]


def _stops(edges: EdgeSet, strips: StripForest, rays: Rays) -> tuple[Floats, Floats]:
    """Earliest and latest stop (r,) of rays on the edges of their states."""
    parts = [capsules_of(edges, strips, some) for some in split_rays(edges, strips, rays)]
    if len(parts) == 1:
        return parts[0].earliest, parts[0].latest
    return np.concatenate([part.earliest for part in parts]), np.concatenate([part.latest for part in parts])
