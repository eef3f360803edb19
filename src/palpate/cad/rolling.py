"""Rolling states: a part that is round but for a socket, a hole or a flat lies the same at every azimuth.

It has a state for each facet, or each place between two holes, and all of them differ: a finger that reaches
into the socket would tell them apart. At heights that neither socket nor hole comes to, whichever way the
part has rolled, their sections are the same, and one state stands for them there.

*Why it holds.* Points of the surface are seen as (distance r from the axis, height h along it). A circle
about the axis through an (r, h) that no point of the surface has is all in the solid or all outside, so a cut
through the axis says which. A model is the cut's outline turned about the axis. Surface within a distance w
of the outline, seen so, is within w of the model at every azimuth; all other surface, `far`, is in a few
ranges of (r, h). Lying with its axis at an angle to the vertical of cosine c, sine s, what is seen at (r, h)
is between the heights c·h − s·r and c·h + s·r above the place where h = 0, however the part has rolled.
Outside of these ranges all real surface is within w of the model, and what is further from the model's
surface than that is solid where the model is.

A triangle is seen in the convex hull of its corners' (r, h) and (e·p, h), where e is a radial direction: r is
convex over the triangle, and at least e·p. Where the hull is neither near the outline nor apart from it, the
triangle is halved.

States of the solid lie as the model does if the angle of the axis and the height of a point on it differ by
no more than their bound: no point moves by more than the height's difference, and the angle's times its
distance from that point. That is counted in the model's `off_mm`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from palpate.base.geometry import Floats
from palpate.cad.parts import Solid, StableState
from palpate.cad.revolution import cut_half_plane, fit_axis_point, revolve, steps_of_turn
from palpate.cad.solid_symmetries import axis_directions, axis_frame
from palpate.cad.stable_states import upright_state

_FEWEST_STATES = 8
"""States that roll into one another; fewer are told apart."""
_LEAST_SHARE = 0.02
"""Probability of a family that is worth it, and of what a nearer model may lose."""
_CLEARLY = 1.05
"""A model that is less near must be worth so many times more."""
_TRIED_SHARES = (0.2, 0.5, 1.0)
"""Of the distance allowed, the nearest first."""
_NEAR_SHARE, _TURN_SHARE, _PROFILE_SHARE, _APART_SHARE = 0.5, 0.15, 0.1, 0.25
"""Of the distance allowed: of surface from the outline, chords of the model, its outline, states."""
_CUT_AZIMUTHS_RAD = tuple(0.7236 + 2.4 * k for k in range(5))
"""Half-planes of which the one with the most material is taken: it is least likely to meet a hole."""
_MOST_PIECES = 50_000
"""Triangles are halved up to so many more; what is undecided then counts as far."""
_LEAST_KNOWN_MM = 0.25
"""Of height: a state that is known at less is none."""


@dataclass(frozen=True, eq=False)
class RollingState:
    """`members` that roll into one another, and the state of a `model` that stands for them."""

    state: StableState
    model: Solid
    members: tuple[StableState, ...]


@dataclass(frozen=True, eq=False)
class _Attitudes:
    """How states lie: `polar_rad` (n,) from down to the axis, `height_mm` (n,) of a point of the axis.

    No point of the solid is further than `reach_mm` from that one.
    """

    polar_rad: Floats
    height_mm: Floats
    reach_mm: float

    def apart_mm(self, polar_rad: float, height_mm: float) -> Floats:
        """Bound (n,) on how far points of the solid are from where another attitude has them."""
        tilt = np.abs(self.polar_rad - polar_rad)
        result: Floats = np.abs(self.height_mm - height_mm) + self.reach_mm * tilt
        return result


def rolling_states(solid: Solid, states: Sequence[StableState], within_mm: float) -> list[RollingState]:
    """Families of at least 8 states that roll about one axis of a solid, and are known at some heights.

    `within_mm`: how far the model may be from the solid at any azimuth, at heights that are known. It is
    nearer if that will do: then walls that are nearly level are known, too.
    """
    best: list[RollingState] = []
    for within in [share * within_mm for share in _TRIED_SHARES] if len(states) >= _FEWEST_STATES else []:
        axis = _likely_axis(solid, states, _APART_SHARE * within)
        model = None if axis is None else _model(solid, *axis, within)
        if axis is not None and model is not None:
            found = _families(solid, states, axis, model, _APART_SHARE * within)
            best = found if _worth(found) > _CLEARLY * _worth(best) else best
    return best


def _worth(families: Sequence[RollingState]) -> float:
    """Probability of families by the share of their height that is known; the fewer the better."""
    known = [sum(high - low for low, high in _ranges_known(item)) / _top_mm(item) for item in families]
    return sum(k * (item.state.probability - _LEAST_SHARE) for k, item in zip(known, families, strict=True))


def _top_mm(item: RollingState) -> float:
    return float((item.model.vertices_mm @ item.state.rotation[2]).max() + item.state.offset_mm[2])


def _ranges_known(item: RollingState) -> list[tuple[float, float]]:
    """Ranges of height at which a state is known."""
    ends = [0.0, *(end for ends in item.state.unknown_mm for end in ends), _top_mm(item)]
    return [(low, high) for low, high in zip(ends[::2], ends[1::2], strict=True) if high > low]


_Axis = tuple[Floats, Floats]
"""Its direction (3,), and a point (3,) of it."""


def _attitudes(solid: Solid, states: Sequence[StableState], axis: _Axis) -> _Attitudes:
    direction, point = axis
    up = np.array([state.rotation[2] for state in states])
    height = up @ point + [state.offset_mm[2] for state in states]
    reach = float(np.linalg.norm(solid.vertices_mm - point, axis=1).max())
    return _Attitudes(np.arccos(np.clip(-up @ direction, -1.0, 1.0)), height, reach)


def _likely_axis(solid: Solid, states: Sequence[StableState], within: float) -> _Axis | None:
    """The axis about which the most probable family of states rolls."""
    share = np.array([state.probability for state in states])
    best, most = None, _LEAST_SHARE
    for direction in axis_directions(solid):
        axis = direction, fit_axis_point(solid, direction)
        lying = _attitudes(solid, states, axis)
        for k in range(min(len(states), 3 * _FEWEST_STATES)):
            near = lying.apart_mm(lying.polar_rad[k], lying.height_mm[k]) <= within
            tilted = math.sin(lying.polar_rad[k]) > 0.05
            if tilted and near.sum() >= _FEWEST_STATES and share[near].sum() > most:
                best, most = axis, float(share[near].sum())
    return best


@dataclass(frozen=True, eq=False)
class _Model:
    """`solid`: of revolution; `far` (k, 6, 2): hulls of (r, h) in which surface is that is not near it."""

    solid: Solid
    far: Floats


def _model(solid: Solid, direction: Floats, point: Floats, within: float) -> _Model | None:
    frame = axis_frame(direction)
    points = (solid.vertices_mm - point) @ frame.T
    cuts = [cut_half_plane(solid, points, azimuth) for azimuth in _CUT_AZIMUTHS_RAD]
    line = max(cuts, key=_turned_volume)
    outline = shapely.simplify(shapely.MultiLineString(line), _PROFILE_SHARE * within)
    rings = [_on_axis(shapely.get_coordinates(part)) for part in shapely.get_parts(outline)]
    if not rings or not outline.is_simple or any(len(ring) < 3 for ring in rings):
        return None
    near = _NEAR_SHARE * within
    far = _far_pieces(points[solid.faces], outline.buffer(near), near)
    number = steps_of_turn(float(outline.bounds[2]), _TURN_SHARE * within)
    made = revolve(solid, rings, frame, point, number)
    chord = math.cos(math.pi / number)
    off = solid.off_mm + near + float(outline.bounds[2]) * (1 - chord) / (1 + chord)
    return _Model(replace(made, off_mm=off), far)


def _on_axis(line: Floats) -> Floats:
    """A line (k, 2) of (r, h) whose ends, if it has any, are quite on the axis."""
    if (line[0] != line[-1]).any():
        line = line.copy()
        line[[0, -1], 0] = 0.0
    return line


def _turned_volume(lines: Sequence[Floats]) -> float:
    """Volume (mm³) inside of lines (k, 2) of (r, h) that are turned about the axis, by Pappus' theorem."""
    legs = [(line[:-1, 0] ** 2 + line[:-1, 0] * line[1:, 0] + line[1:, 0] ** 2) for line in lines]
    rises = [np.diff(line[:, 1]) for line in lines]
    return math.pi / 3 * sum(float(leg @ rise) for leg, rise in zip(legs, rises, strict=True))


def _far_pieces(triangles: Floats, near: shapely.Geometry, least: float) -> Floats:
    """Hulls (k, 6, 2) of what is not seen in a region; what straddles its border is cut to a least size."""
    shapely.prepare(near)
    far, looked = [np.zeros((0, 6, 2))], -len(triangles)
    while len(triangles):
        seen = _profile_hulls(triangles)
        hulls = shapely.convex_hull(shapely.multipoints(seen))
        rest = ~shapely.covers(near, hulls)
        small = np.ptp(seen, axis=1).max(axis=1) <= least
        looked += len(triangles)
        done = small | ~shapely.intersects(near, hulls) | (looked > _MOST_PIECES)
        far.append(seen[rest & done])
        triangles = _halves(triangles[rest & ~done])
    return np.concatenate(far)


def _profile_hulls(triangles: Floats) -> Floats:
    """Points (k, 6, 2) of (r, h) in whose hull triangles (k, 3, 3) about the z axis are seen."""
    across, height = triangles[:, :, :2], triangles[:, :, 2]
    radius = np.hypot(across[..., 0], across[..., 1])
    middle = across.sum(axis=1)
    middle /= np.maximum(np.linalg.norm(middle, axis=1), 1e-300)[:, None]
    least = np.einsum("kcj,kj->kc", across, middle)
    least[least.min(axis=1) < 0] = 0.0
    return np.concatenate([np.stack([radius, height], axis=2), np.stack([least, height], axis=2)], axis=1)


def _halves(triangles: Floats) -> Floats:
    """Both halves of triangles (k, 3, 3), cut at their longest sides."""
    sides = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
    first, rows = sides.argmax(axis=1), np.arange(len(triangles))
    a, b, c = (triangles[rows, (first + k) % 3] for k in range(3))
    middle = (a + b) / 2
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


def _families(
    solid: Solid, states: Sequence[StableState], axis: _Axis, model: _Model, within: float
) -> list[RollingState]:
    """Families whose axis is as that of a state, the most probable first."""
    lying = _attitudes(solid, states, axis)
    left = np.ones(len(states), dtype=bool)
    found: list[RollingState] = []
    for seed in range(len(states)):
        polar = float(lying.polar_rad[seed])
        near = left & (lying.apart_mm(polar, float(lying.height_mm[seed])) <= 2 * within)
        if not left[seed] or near.sum() < _FEWEST_STATES:
            continue
        rests = _rest(model.solid, axis, polar, [states[seed]])
        height = float(rests.rotation[2] @ axis[1] + rests.offset_mm[2])
        apart = lying.apart_mm(polar, height)
        near &= apart <= within
        members = [state for state, is_near in zip(states, near.tolist(), strict=True) if is_near]
        if len(members) < _FEWEST_STATES or sum(state.probability for state in members) < _LEAST_SHARE:
            continue
        left &= ~near
        made = replace(model.solid, off_mm=model.solid.off_mm + float(apart[near].max()))
        unknown = _ranges_unknown(model.far, polar, height, made.off_mm)
        state = replace(_rest(made, axis, polar, members), unknown_mm=unknown)
        family = RollingState(state, made, tuple(members))
        if any(high - low >= _LEAST_KNOWN_MM for low, high in _ranges_known(family)):
            found.append(family)
    return found


def _rest(model: Solid, axis: _Axis, polar: float, states: Sequence[StableState]) -> StableState:
    """The state of a model whose axis is at an angle from down, in place of others."""
    x, _, z = axis_frame(axis[0])
    return upright_state(model, math.cos(polar) * z + math.sin(polar) * x, states)


def _ranges_unknown(far: Floats, polar: float, height: float, off: float) -> tuple[tuple[float, float], ...]:
    """Ranges of height (mm), ascending and apart, to which far pieces may come; widened by `off`."""
    along, across = -math.cos(polar) * far[:, :, 1], math.sin(polar) * far[:, :, 0]
    low = height - off + (along - across).min(axis=1, initial=np.inf)
    high = height + off + (along + across).max(axis=1, initial=-np.inf)
    ranges: list[tuple[float, float]] = []
    for begin, end in sorted(zip(low.tolist(), high.tolist(), strict=True)):
        if ranges and begin <= ranges[-1][1]:
            ranges[-1] = ranges[-1][0], max(ranges[-1][1], end)
        else:
            ranges.append((begin, end))
    return tuple(ranges)
