"""Hypotheses, the recogniser's answer: object, state, configuration, certified bounds and weight.

See docs/recogniser.md, "Hypotheses". Kept as arrays; one `Hypothesis` is a view of a row.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import overload

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import cross
from palpate.base.short_repr import ShortRepr, show_within
from palpate.recognizer.constraints import Constraints
from palpate.recognizer.contact import Contact
from palpate.recognizer.edges import NULL_EDGE, CatalogueState
from palpate.recognizer.model_test import sinusoid_maximum
from palpate.recognizer.pose_region import Cells, Regions
from palpate.recognizer.tables import round_to_nine_digits
from palpate.recognizer.witness_search import Enclosures, enclosures

_PARALLEL_SINE = 1e-6  # sine of the angle between edges that count as parallel


@dataclass(frozen=True)
class Configuration:
    """Maps object coordinates as given in the objects file to W: x ↦ R(θ) x + (x, y); mm, rad."""

    x_mm: float
    y_mm: float
    theta_rad: float


@dataclass(frozen=True)
class Bounds:
    """Intervals (lo, hi) that contain the true configuration if every error is within its bound."""

    x_mm: tuple[float, float]
    y_mm: tuple[float, float]
    theta_rad: tuple[float, float]

    @property
    def position_half_mm(self) -> float:
        """Larger half-width of the two position intervals."""
        return max(self.x_mm[1] - self.x_mm[0], self.y_mm[1] - self.y_mm[0]) / 2

    @property
    def orientation_half_rad(self) -> float:
        """Half-width of the orientation interval."""
        return (self.theta_rad[1] - self.theta_rad[0]) / 2


@dataclass(frozen=True)
class Slide:
    """A one-parameter family: the object may lie anywhere along a line, as far as the contacts say.

    `direction_rad` in W, in [0, π). The object's position along it, from that of the hypothesis's
    configuration on, is within `extent_mm` (lo, hi).
    """

    direction_rad: float
    extent_mm: tuple[float, float]


@dataclass(frozen=True, eq=False, repr=False)
class Hypothesis(ShortRepr):
    """One way to understand all contacts.

    `verified`: `configuration` satisfies every contact and every free path, on true arcs and with round
    bounds (`verify`), except for contacts that `spurious` names; `witness_mm` (2,) is its position s as in
    `cells`, the region itself, and `witness_node` the interpretation. `weight`: share of the feasible volume
    of all hypotheses, each times its state's probability. `search_bounds`: those of one orientation of each
    that a symmetry makes equal; a round state is searched as a polygon.
    """

    state_index: int
    state: CatalogueState
    configuration: Configuration
    witness_mm: Floats
    search_bounds: Bounds
    weight: float
    verified: bool
    witness_node: int
    cells: Cells
    constraints: Constraints

    def _facts(self) -> Iterator[str]:
        at, bounds = self.configuration, self.bounds
        yield f"{self.state.object_name}/{self.state.state.name}"
        yield f"x={show_within(at.x_mm, bounds.x_mm, ' mm')}"
        yield f"y={show_within(at.y_mm, bounds.y_mm, ' mm')}"
        lo, hi = map(math.degrees, bounds.theta_rad)
        turned = show_within(math.degrees(at.theta_rad), (lo, hi), "°")
        yield f"theta={'any' if self.state.state.is_round else turned}"
        yield f"weight={self.weight:.4g}"
        yield "verified" if self.verified else "not verified"

    @property
    def bounds(self) -> Bounds:
        """Bounds as an answer states them: a round state may have any orientation, within [−π, π].

        Turned about its centre, it takes the origin of its file along.
        """
        if not self.state.state.is_round:
            return self.search_bounds
        off = 2 * float(np.hypot(*self.state.origin_mm))
        (x_lo, x_hi), (y_lo, y_hi) = self.search_bounds.x_mm, self.search_bounds.y_mm
        return Bounds((x_lo - off, x_hi + off), (y_lo - off, y_hi + off), (-np.pi, np.pi))

    @property
    def null_contacts(self) -> tuple[Contact, ...]:
        """Contacts that are spurious if this hypothesis is true: those that `configuration` leaves out.

        As few as in any of its interpretations, unless no configuration was found for these.
        """
        edges = self.constraints.nodes.edges[self.witness_node]
        return tuple(
            contact
            for contact, edge in zip(self.constraints.touched, edges, strict=True)
            if edge == NULL_EDGE
        )

    @property
    def spurious(self) -> tuple[str, ...]:
        """Names of `null_contacts`."""
        return tuple(contact.name for contact in self.null_contacts)

    @cached_property
    def slide(self) -> Slide | None:
        """The family that is left if all contacts are on parallel edges (memo §2.2.3), otherwise None.

        It is the largest of the interpretations that counts; the extent holds for all of them. None as well
        where some contact is paired with no edge, so that it is not known which one it is on.
        """
        if self.constraints.has_unpaired:
            return None
        volume = np.bincount(self.cells.node, self.cells.volume)
        node = self.constraints.nodes.select(np.array([np.argmax(volume)]))
        along = np.concatenate(
            [
                self.constraints.catalogue.edges(contact.finger).direction[node.edges[:, level]]
                for level, contact in enumerate(self.constraints.touched)
                if node.edges[0, level] != NULL_EDGE
            ]
        )
        if np.abs(cross(along[:1], along)).max() > _PARALLEL_SINE:
            return None
        # Seen from the table the direction is the same on every branch of a symmetry.
        turned = np.arctan2(along[0, 1], along[0, 0]) + (node.lo + node.hi) / 2
        direction = float(turned[0] % np.pi)
        x, y = np.cos(direction), np.sin(direction)
        s, cells = self.cells.polygon, self.cells
        a, b = s[..., 0] * x + s[..., 1] * y, s[..., 0] * y - s[..., 1] * x
        lo, hi = cells.lo[:, None], cells.hi[:, None]
        at = self.configuration.theta_rad
        here = float(self.witness_mm @ [x * np.cos(at) + y * np.sin(at), y * np.cos(at) - x * np.sin(at)])
        low, high = (
            -float(sinusoid_maximum(-a, -b, lo, hi).max()),
            float(sinusoid_maximum(a, b, lo, hi).max()),
        )
        return Slide(direction, (low - here - 1e-9, high - here + 1e-9))

    @cached_property
    def features(self) -> tuple[tuple[int | None, ...], ...]:
        """Features of the paired edges (see `GrownSection`) of each interpretation, in contact order.

        None for a null contact, and for one that is not paired. Interpretations with the fewest come first.
        """
        constraints = self.constraints
        pairings: Ints = np.unique(constraints.nodes.edges[np.unique(self.cells.node)], axis=0)
        columns = constraints.all_columns(pairings)
        touched = [contact for contact in constraints.evidence.contacts if contact.touched]
        rows = {
            tuple(
                None if edge == NULL_EDGE else int(constraints.catalogue.edges(contact.finger).feature[edge])
                for contact, edge in zip(touched, pairing, strict=True)
            )
            for pairing in columns.tolist()
        }
        return tuple(sorted(rows, key=_fewest_nulls_first))


@dataclass(frozen=True, eq=False, repr=False)
class Hypotheses(ShortRepr, Sequence[Hypothesis]):
    """h hypotheses: those with the fewest null contacts first, the heaviest of them before the others.

    `regions` (h); `state` (h,); `position_mm` (h, 2) of the file's origin in W; `weight` (h,) sums to 1.
    """

    constraints: Constraints
    regions: Regions
    state: Ints
    position_mm: Floats
    weight: Floats

    def __len__(self) -> int:
        return len(self.state)

    @overload
    def __getitem__(self, index: int) -> Hypothesis: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Hypothesis]: ...
    def __getitem__(self, index: int | slice) -> Hypothesis | Sequence[Hypothesis]:
        return self._views[index]

    def __iter__(self) -> Iterator[Hypothesis]:
        return iter(self._views)

    @property
    def verified(self) -> Bools:
        """Mask of hypotheses that have a witness, (h,)."""
        return self.regions.verified

    @property
    def lo(self) -> Floats:
        """Least x, y (mm) and θ (rad), (h, 3)."""
        return self._bounds[0]

    @property
    def hi(self) -> Floats:
        """Largest x, y (mm) and θ (rad), (h, 3)."""
        return self._bounds[1]

    @property
    def cells(self) -> Cells:
        """Cells of all, on the branches of their interpretations, as fine as those that bounds are of."""
        return self._enclosures.cells

    @cached_property
    def _enclosures(self) -> Enclosures:
        return enclosures(self.constraints, self.regions)

    @cached_property
    def _bounds(self) -> tuple[Floats, Floats]:
        found = self._enclosures
        witness = np.column_stack([self.position_mm, self.regions.theta])
        return np.minimum(found.lo, witness), np.maximum(found.hi, witness)

    @cached_property
    def _views(self) -> tuple[Hypothesis, ...]:
        return tuple(self._view(row) for row in range(len(self)))

    def _view(self, row: int) -> Hypothesis:
        regions, state = self.regions, int(self.state[row])
        (x_lo, y_lo, theta_lo), (x_hi, y_hi, theta_hi) = self.lo[row].tolist(), self.hi[row].tolist()
        x, y = self.position_mm[row].tolist()
        return Hypothesis(
            state_index=state,
            state=self.constraints.catalogue.states[state],
            configuration=Configuration(x, y, float(regions.theta[row])),
            witness_mm=regions.position[row],
            search_bounds=Bounds((x_lo, x_hi), (y_lo, y_hi), (theta_lo, theta_hi)),
            weight=float(self.weight[row]),
            verified=bool(regions.verified[row]),
            witness_node=int(regions.node[row]),
            cells=regions.cells.select(slice(int(regions.first[row]), int(regions.first[row + 1]))),
            constraints=self.constraints,
        )


def hypotheses_of(constraints: Constraints, regions: Regions) -> Hypotheses:
    """The regions with their weights, in the order of `Hypotheses`."""
    begin = regions.first[:-1]
    state = regions.cells.state[begin]
    volume = np.add.reduceat(regions.cells.volume, begin) if len(begin) else np.empty(0)
    volume = volume * constraints.catalogue.prior[state]
    cos, sin = np.cos(regions.theta), np.sin(regions.theta)
    x, y = (regions.position - constraints.catalogue.origins_mm[state]).T
    position = np.column_stack([cos * x - sin * y, sin * x + cos * y]) + constraints.anchor_mm
    # Of two that are alike in all that, as two places of one state may be, the one turned less is first.
    rows = np.lexsort(
        (regions.theta.round(6), state, -round_to_nine_digits(volume), constraints.nulls[regions.node])
    )
    weight = volume / (float(volume.sum()) or 1.0)
    return Hypotheses(constraints, regions.select(rows), state[rows], position[rows], weight[rows])


def _fewest_nulls_first(row: tuple[int | None, ...]) -> tuple[int, tuple[tuple[bool, int], ...]]:
    return row.count(None), tuple((feature is None, feature or 0) for feature in row)
