"""The compiled kernel grows the tree, cuts cells and sweeps paths as numpy does with whole arrays."""

import pickle
from collections import Counter, defaultdict
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from kernel_switch import needs_kernel, without_kernel
from sampling import sample
from scipy.optimize import linprog
from verification_cases import drawn_case

from palpate.recognizer import Catalogue, Contact
from palpate.recognizer.approach import Approach
from palpate.recognizer.budget import Budget, BudgetSpentError
from palpate.recognizer.compiled import KERNEL
from palpate.recognizer.constraints import free_path_test, sweep
from palpate.recognizer.interpretation_tree import Interpretations, next_level, second_level
from palpate.recognizer.model_test import all_half_planes
from palpate.recognizer.pose_region import Cells, build_cells, corner_mask, divide_orientations
from palpate.recognizer.recognition import anchor_of
from palpate.recognizer.tree_branches import extend_by_region

pytestmark = needs_kernel

FEW = 20
CASES = sample(range(0, 30 * FEW, FEW), range(0, 2 * FEW, FEW))


def by_pairing(nodes: Interpretations) -> dict[tuple[int, ...], list[tuple[float, float]]]:
    found: dict[tuple[int, ...], list[tuple[float, float]]] = defaultdict(list)
    for edges, lo, hi in zip(nodes.edges.tolist(), nodes.lo.tolist(), nodes.hi.tolist(), strict=True):
        found[tuple(edges)].append((lo, hi))
    return {edges: sorted(ends) for edges, ends in found.items()}


def is_possible(
    catalogue: Catalogue, touched: list[Contact], edges: tuple[int, ...], kept: list[tuple[float, float]]
) -> bool:
    """Whether positions are in the rectangles of all contacts at one of many orientations kept, by scipy.

    Only there: what their normals exclude, both sides have left out.
    """
    anchor = anchor_of(touched)
    g, coefficients = all_half_planes(catalogue, np.array([edges]), touched, anchor)
    for theta in np.concatenate([np.linspace(lo, hi, 91) for lo, hi in kept]):
        limit = coefficients[0] @ [1.0, np.cos(theta), np.sin(theta)]
        if linprog([0.0, 0.0], g[0], limit, bounds=(None, None)).status == 0:
            return True
    return False


def assert_same(
    catalogue: Catalogue, touched: list[Contact], found: Interpretations, expected: Interpretations
) -> int:
    """Equal, but for pairings that are not possible: how many of them one side alone rules out."""
    one, two = by_pairing(found), by_pairing(expected)
    alone = {**one, **two}
    for edges in one.keys() & two.keys():
        del alone[edges]
    assert not any(is_possible(catalogue, touched, edges, kept) for edges, kept in alone.items())
    for edges in one.keys() & two.keys():
        np.testing.assert_allclose(one[edges], two[edges], rtol=0, atol=1e-8)
    return len(alone)


def grown(catalogue: Catalogue, touched: list[Contact]) -> list[Interpretations]:
    """The levels of up to four contacts."""
    anchor = anchor_of(touched)
    levels = [second_level(catalogue, touched[:2], Budget(10**8))[0]]
    if len(touched) > 2:
        levels.append(next_level(catalogue, levels[-1], touched[:3], anchor, Budget(10**8))[0])
    if len(touched) > 3:
        cells = cells_of(catalogue, levels[-1], touched[:3])
        levels.append(extend_by_region(catalogue, levels[-1], cells, touched[3], 4, anchor, Budget(10**8))[0])
    return levels


def cells_of(catalogue: Catalogue, nodes: Interpretations, touched: list[Contact]) -> Cells:
    intervals = divide_orientations(nodes, step_rad=0.05, least=2)
    return build_cells(catalogue, nodes, touched, anchor_of(touched), intervals)


@pytest.mark.parametrize("first", CASES)
def test_levels_cells_and_paths_are_the_same(first: int) -> None:
    seen: Counter[str] = Counter()
    for seed in range(first, first + FEW):
        case = drawn_case(seed)
        touched = [contact for contact in case.contacts if contact.touched][:4]
        if len(touched) < 2:
            continue
        found = grown(catalogue := case.catalogue(), touched)
        with without_kernel():
            other = case.catalogue()
            expected = grown(other, touched)
        for one, two in zip(found, expected, strict=True):
            seen["alone"] += assert_same(catalogue, touched[: one.edges.shape[1]], one, two)
        seen["interpretations"] += sum(map(len, found))
        nodes = found[min(1, len(found) - 1)]
        used = touched[: nodes.edges.shape[1]]
        cells = cells_of(catalogue, nodes, used)
        with without_kernel():
            assert_same_cells(cells, cells_of(other, nodes, used))
        seen["cells"] += len(cells)
        paths = [
            Approach(item.finger, item.start_mm, item.direction_rad, item.travel_mm, item.free_path_bound_mm)
            for item in case.contacts
        ]
        anchor = anchor_of(used)
        stops, free = (
            sweep(catalogue, cells, anchor, paths),
            free_path_test(catalogue, cells, anchor, case.contacts),
        )
        with without_kernel():
            reference = sweep(other, cells, anchor, paths)
            assert np.array_equal(free, free_path_test(other, cells, anchor, case.contacts))
        np.testing.assert_allclose(stops.earliest, reference.earliest, rtol=0, atol=1e-8)
        np.testing.assert_allclose(stops.latest, reference.latest, rtol=0, atol=1e-8)
        seen["blocked"] += int((~free).sum())
    assert seen["interpretations"] > FEW
    assert seen["cells"] > FEW


def assert_same_cells(found: Cells, expected: Cells) -> None:
    assert np.array_equal(found.node, expected.node)
    for one, two in ((found.lo, expected.lo), (found.hi, expected.hi), (found.volume, expected.volume)):
        np.testing.assert_allclose(one, two, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.centre, expected.centre, rtol=0, atol=1e-8)
    assert np.all(corner_mask(found.polygon).sum(axis=1) >= 1)


class SmallerBudget(Budget):
    """So small that drawn cases, which numpy has to get through as well, come to its end."""

    pairs = property(lambda self: Budget.pairs.fget(self) // 400)  # type: ignore[attr-defined]
    interpretations = property(lambda self: Budget.interpretations.fget(self) // 400)  # type: ignore[attr-defined]


def test_a_spent_budget_is_the_same() -> None:
    seen: Counter[str] = Counter()
    for seed, units in product(range(12), (10_000, 100_000, 1_000_000)):
        case = drawn_case(seed)
        touched = [replace(contact, normal=None) for contact in case.contacts if contact.touched][:2]
        if len(touched) < 2:
            continue
        budget = SmallerBudget(units)
        found = outcome(case.catalogue(), touched, budget)
        with without_kernel():
            assert outcome(case.catalogue(), touched, budget) == found
        seen[found] += 1
    assert min(seen["spent"], seen["done"]) > 3


def outcome(catalogue: Catalogue, touched: list[Contact], budget: Budget) -> str:
    try:
        second_level(catalogue, touched, budget)
    except BudgetSpentError:
        return "spent"
    return "done"


def test_arrays_that_do_not_fit_are_refused() -> None:
    assert KERNEL is not None
    edges = drawn_case(0).catalogue().edges(drawn_case(0).contacts[0].finger)
    arrays = list(edges.arrays)
    for number in range(len(arrays)):
        short = [*arrays[:number], np.ascontiguousarray(arrays[number][:-1]), *arrays[number + 1 :]]
        with pytest.raises(ValueError, match="do not fit together"):
            KERNEL.prepared_edges(tuple(short))
    with pytest.raises(ValueError, match="invalid PyCapsule"):
        KERNEL.narrow((object(), object()), ((0.0, 0.0, 0.0),) * 2, b"", b"", b"", 1)


def test_a_catalogue_goes_to_another_process() -> None:
    catalogue = drawn_case(1).catalogue()
    finger = drawn_case(1).contacts[0].finger
    edges = catalogue.edges(finger)
    assert edges.prepared is not None
    again = pickle.loads(pickle.dumps(edges))
    assert np.array_equal(again.start, edges.start)
    assert again.prepared is not None
