"""Interpretations (memo §2): pairings of contacts with edges, each with an interval of orientations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.budget import STANDARD_BUDGET, Budget
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact, NormalRange
from palpate.recognizer.edges import NULL_EDGE, EdgeSet
from palpate.recognizer.tables import Table


@dataclass(frozen=True, eq=False)
class Query:
    """Contacts to be paired with edges of a catalogue, in the order in which interpretations pair them.

    Positions of the object are counted from `anchor_mm` (2,) in W.
    """

    catalogue: Catalogue
    contacts: Sequence[Contact]
    anchor_mm: Floats
    budget: Budget = STANDARD_BUDGET

    @cached_property
    def edges(self) -> list[EdgeSet]:
        """Edges that each contact may be paired with."""
        return [self.catalogue.edges(contact.finger) for contact in self.contacts]

    @cached_property
    def normals(self) -> list[NormalRange] | None:
        """Outward normals that each contact allows; None if one of them allows none."""
        found = [contact.outward_normals() for contact in self.contacts]
        allowed = [normals for normals in found if normals is not None]
        return allowed if len(allowed) == len(found) else None

    def select(self, contacts: Sequence[int]) -> "Query":
        """The same query about some of its contacts."""
        return replace(self, contacts=[self.contacts[k] for k in contacts])


@dataclass(frozen=True)
class LevelCount:
    """Numbers of interpretations at each step of a level of the tree (the memo's columns n, nA, nD, M)."""

    level: int
    candidates: int
    after_angle: int
    after_distance: int
    after_model: int


@dataclass(frozen=True, eq=False)
class Children(Table):
    """n pairings of one more contact with `edge` (n,), under the row `parent` (n,), θ in [`lo`, `hi`]."""

    parent: Ints
    edge: Ints
    lo: Floats
    hi: Floats

    def narrow(self, lo: Floats, hi: Floats) -> "Children":
        """The same with other orientation intervals; those with none left are dropped."""
        return replace(self, lo=lo, hi=hi).select(np.flatnonzero(lo <= hi))


@dataclass(frozen=True, eq=False)
class TreeLevel:
    """Children of a level: `looked_up` edges had normals that fit, and `near` of them fitting distances."""

    children: Children
    looked_up: int
    near: int


@dataclass(frozen=True, eq=False)
class Interpretations(Table):
    """n k-interpretations: `state` (n,), `edges` (n, k) in contact order, θ within [`lo`, `hi`] (n,) rad."""

    state: Ints
    edges: Ints
    lo: Floats
    hi: Floats

    @classmethod
    def none(cls, contacts: int) -> "Interpretations":
        """No interpretation of so many contacts."""
        none = np.empty(0, np.int64)
        return cls(none, np.empty((0, contacts), np.int64), np.empty(0), np.empty(0))

    def extend(self, found: Children) -> "Interpretations":
        """(k + 1)-interpretations: those at `found.parent`, each with one more pairing."""
        edges = np.column_stack([self.edges[found.parent], found.edge])
        return Interpretations(self.state[found.parent], edges, found.lo, found.hi)

    def turn(self, bound_rad: Floats) -> "Interpretations":
        """The same after turns of up to `bound_rad` (n,); those of one pairing that meet become one."""
        pairings = np.column_stack([self.state, self.edges])
        key = np.unique(pairings, axis=0, return_inverse=True)[1].ravel()
        order = np.lexsort((self.lo, key))
        key, lo, hi = key[order], (self.lo - bound_rad)[order], (self.hi + bound_rad)[order]
        begins = np.ones(len(key), dtype=bool)
        begins[1:] = (key[1:] != key[:-1]) | (lo[1:] > hi[:-1])
        first = np.flatnonzero(begins)
        if not len(first):
            return self
        hi = np.minimum(np.maximum.reduceat(hi, first), lo[first] + 2 * np.pi)
        return replace(self.select(order[first]), lo=lo[first], hi=hi)

    def narrow(self, lo: Floats, hi: Floats) -> "Interpretations":
        """The same with other orientation intervals; those with none left are dropped."""
        return replace(self, lo=lo, hi=hi).select(np.flatnonzero(lo <= hi))

    def null_mask(self, contacts: Sequence[Contact]) -> Bools | None:
        """Mask (n, m) of contacts, misses included, that are null. Misses are never null; None if none is."""
        null = self.edges == NULL_EDGE
        if not null.any():
            return None
        result = np.zeros((len(self), len(contacts)), dtype=bool)
        result[:, [k for k, contact in enumerate(contacts) if contact.touched]] = null
        return result


def orientation_range(normals: NormalRange, edges: EdgeSet, edge: Ints) -> tuple[Floats, Floats]:
    """Orientations (lo, hi), each (n,), that turn an edge's normal into the given range (memo §2.2.2)."""
    psi, span = edges.normal_rad[edge], edges.span[edge]
    lo = normals.lo_rad - psi - span
    width = np.minimum(normals.hi_rad - normals.lo_rad + 2 * span, 2 * np.pi)
    return lo, lo + width


def intersect(lo: Floats, hi: Floats, other_lo: Floats, other_hi: Floats) -> tuple[Floats, Floats]:
    """Hull of the part of [lo, hi] inside [other_lo, other_hi] modulo 2π; lo > hi where there is none."""
    width, other_width = hi - lo, other_hi - other_lo
    begin = (other_lo - lo) % (2 * np.pi)
    tail = begin - 2 * np.pi + other_width
    first = np.where(tail >= 0, 0.0, np.where(begin <= width, begin, np.inf))
    last = np.where(begin <= width, np.minimum(width, begin + other_width), np.minimum(width, tail))
    return lo + first, lo + last
