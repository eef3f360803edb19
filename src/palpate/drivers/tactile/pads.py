"""Patches on flat and free arrays: connected sets of taxels. Counts in, patches out.

A flat pad cannot tell the object's normal: the range is the half circle in front of it. On a free array the
contact's direction lies among those of the patch's taxels and half a step to their neighbours. The centroid
of a patch may be where nothing touches, as between two corners. So each column is tested for whether its
reading could be crosstalk from its neighbours, with gains at their bounds, and noise. If not, something
presses on it.
"""

import math
from dataclasses import dataclass, fields

import numpy as np
from scipy.ndimage import binary_dilation, binary_propagation, label, uniform_filter

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.drivers.tactile.baseline import BOUND_SIGMAS
from palpate.drivers.tactile.columns import (
    CellLoads,
    UnseenLoads,
    centroids,
    crosstalk_limit_n,
    load_beyond_edge,
    log_concave_limit_n,
)
from palpate.drivers.tactile.description import TaxelSurface
from palpate.drivers.tactile.patches import (
    Patches,
    PatchFlag,
    TipCalibration,
    empty_patches,
    mask_untouched,
    scatter_patches,
)


@dataclass(frozen=True, eq=False)
class TaxelForces:
    """Forces of n frames, each (n, r, c): `force_n` above zero, 0 where not `usable`; `noise_n`: its standard
    deviation; `drift_n`: bound of what the zeros are off by; `full`: at the largest count. Full and dead
    taxels are not usable.
    """

    force_n: Floats
    noise_n: Floats
    drift_n: Floats
    usable: Bools
    full: Bools

    def frames(self, which: Ints) -> "TaxelForces":
        """Selection of the frames."""
        return TaxelForces(**{f.name: getattr(self, f.name)[which] for f in fields(TaxelForces)})

    @property
    def doubt_n(self) -> Floats:
        """Less than this may be nothing."""
        result: Floats = BOUND_SIGMAS * self.noise_n + self.drift_n
        return result


def _pressed_columns(taxels: TaxelForces, calibration: TipCalibration) -> Bools:
    """Columns (n, c) that are certainly pressed, in n frames.

    None beside a taxel that cannot be read: what it bears its neighbours may show.
    """
    force, doubt = _sums(taxels)
    spread = float(calibration.spreads.max())
    share = calibration.crosstalk + calibration.crosstalk_bound
    # A column keeps what its two neighbours do not take of its force.
    most = np.maximum(force + doubt, 0.0) / (1 - spread) / max(1 - 2 * share, 1e-9)
    most = np.where(taxels.usable.all(axis=1), most, np.inf)
    beside = np.zeros_like(most)
    beside[:, 1:] += most[:, :-1]
    beside[:, :-1] += most[:, 1:]
    result: Bools = (force - doubt) / (1 + spread) > share * beside
    return result


def _pressed_places_mm(pressed: Bools, column_mm: Floats, half_mm: float) -> Floats:
    """Ranges (n, 2, 2) of places across the array, [first, last] and [from, to]: in each something presses.

    `pressed` (n, c): as `pressed_columns`; `column_mm` (c,) ascending: their middles, each `half_mm` wide to
    either side. The ranges are equal if a single column is certainly pressed, and nan where none is.
    """
    first, last = np.argmax(pressed, axis=1), len(column_mm) - 1 - np.argmax(pressed[:, ::-1], axis=1)
    middle = column_mm[np.column_stack([first, last])]
    found: Floats = middle[..., None] + np.array([-half_mm, half_mm])
    some: Bools = np.any(pressed, axis=1)
    return np.where(some[:, None, None], found, np.nan)


def _loaded_places_mm(taxels: TaxelForces, column_mm: Floats, half_mm: float) -> Floats:
    """The range (n, 2) across the array outside of which columns show nothing; nan where none does."""
    force, doubt = _sums(taxels)
    loaded: Bools = np.logical_or(force > doubt, ~taxels.usable.all(axis=1))
    result: Floats = _pressed_places_mm(loaded, column_mm, half_mm)[:, [0, 1], [0, 1]]
    return result


def _sums(taxels: TaxelForces) -> tuple[Floats, Floats]:
    """Force and doubt of each column, both (n, c) N."""
    doubt = BOUND_SIGMAS * np.sqrt((taxels.noise_n**2).sum(axis=1)) + taxels.drift_n.sum(axis=1)
    return taxels.force_n.sum(axis=1), doubt


_MIN_TAXEL_SHARE = 0.04  # of the strongest taxel: less does not belong to the patch
_MAX_STEPS_BEYOND_EDGE = 5.0  # half steps between normals that a patch may go on for beyond an edge
_FLAT_RAD = math.radians(1.0)
_FRAME_NEIGHBOURS = np.zeros((3, 3, 3), dtype=bool)
_FRAME_NEIGHBOURS[1] = True


@dataclass(frozen=True, eq=False)
class _Patch:
    """Masks (n, k): cells of the strongest patch; `around`: those, their neighbours, and what cells beside
    show together although no one of them does; `others`: patches besides. `cut` (4, n): it goes on beyond a
    side.
    """

    cells: Bools
    around: Bools
    others: Bools
    cut: Bools


def pad_patches(taxels: TaxelForces, surface: TaxelSurface, calibration: TipCalibration) -> Patches:
    """Patches of n frames."""
    # Most frames of a recording show nothing at all.
    some = np.flatnonzero((taxels.force_n > taxels.doubt_n).any(axis=(1, 2)))
    if not len(some):
        return empty_patches(len(taxels.force_n))
    return scatter_patches(_patches(taxels.frames(some), surface, calibration), some, len(taxels.force_n))


def _patches(taxels: TaxelForces, surface: TaxelSurface, calibration: TipCalibration) -> Patches:
    found = _strongest(taxels, surface, calibration)
    n = len(taxels.force_n)
    force = taxels.force_n.reshape(n, -1)
    seen = taxels.usable.reshape(n, -1)
    total = np.where(found.around, force, 0.0).sum(axis=1)
    touched = total >= calibration.contact_force_n
    hidden = np.where(found.around & ~seen, _hidden_n(taxels, calibration).reshape(n, -1), 0.0)
    position, bound = _position(taxels, found, hidden, surface, calibration)
    angle, half, extent = _directions(force, found, surface)
    full = taxels.full.reshape(n, -1)
    flags = _flags(found, seen, full)
    force_bound = _force_bound(taxels, found, hidden, calibration)
    force_bound[(full & found.around).any(axis=1)] = np.inf
    nothing = np.full(n, np.nan)
    return mask_untouched(
        Patches(
            touched=touched,
            angle_rad=angle,
            angle_half_range_rad=half,
            centroid_rad=nothing,
            centroid_bound_rad=nothing,
            position_mm=position,
            position_bound_mm=bound,
            height_mm=position[:, 2],
            height_bound_mm=bound[:, 2],
            force_n=total,
            force_bound_n=force_bound,
            extent_rad=extent,
            area_mm2=(found.cells & seen) @ surface.area_mm2,
            **_across(taxels, surface, calibration),
            flags=flags.astype(np.uint8),
        )
    )


def _across(taxels: TaxelForces, surface: TaxelSurface, calibration: TipCalibration) -> dict[str, Floats]:
    """Ranges across a flat array that are certainly pressed (n, 2, 2), or may be (n, 2); nan on a
    free one.
    """
    n, _, cols = taxels.force_n.shape
    if not surface.flat:
        return {"pressed_mm": np.full((n, 2, 2), np.nan), "loaded_mm": np.full((n, 2), np.nan)}
    column_mm, half_mm = surface.place_mm[:cols, 0], float(surface.half_mm[0])
    pressed = _pressed_columns(taxels, calibration)
    return {
        "pressed_mm": _pressed_places_mm(pressed, column_mm, half_mm),
        "loaded_mm": _loaded_places_mm(taxels, column_mm, half_mm),
    }


def _strongest(taxels: TaxelForces, surface: TaxelSurface, calibration: TipCalibration) -> _Patch:
    """Connected cells above the noise; ones that cannot be seen join what is beside them."""
    taxel_n = taxels.force_n
    n = len(taxel_n)
    limit = np.maximum(taxels.doubt_n, _MIN_TAXEL_SHARE * taxel_n.max(axis=(1, 2), keepdims=True))
    active = (taxel_n > limit) | ~taxels.usable
    labels, count = label(active, structure=_FRAME_NEIGHBOURS)
    flat = labels.reshape(n, -1)
    force = np.bincount(flat.ravel(), taxel_n.ravel(), count + 1)
    frame = np.zeros(count + 1, dtype=np.int64)
    frame[flat.ravel()] = np.repeat(np.arange(n), flat.shape[1])
    force[0], frame[0] = -np.inf, -1
    best = np.zeros(n, dtype=np.int64)
    order = np.lexsort((force, frame))[1:]
    best[frame[order]] = order  # the last one stays, which is the strongest
    cells = (flat == best[:, None]) & (best > 0)[:, None]
    loaded = force > 0
    others = loaded[flat] & ~cells & (flat > 0)
    shape = taxel_n.shape
    weak = _shown_together(taxels) & ~others.reshape(shape)
    reached = binary_propagation(
        cells.reshape(shape), structure=_FRAME_NEIGHBOURS, mask=weak | cells.reshape(shape)
    )
    around = binary_dilation(reached, structure=_FRAME_NEIGHBOURS).reshape(n, -1) & ~others
    return _Patch(cells, around, others, _cut(taxels, cells, surface, calibration))


def _cut(taxels: TaxelForces, cells: Bools, surface: TaxelSurface, calibration: TipCalibration) -> Bools:
    """True where a patch's cells on a side bear more than crosstalk from the next ones explains, (4, n)."""
    n = len(cells)
    force, doubt = taxels.force_n.reshape(n, -1), taxels.doubt_n.reshape(n, -1)
    seen, spread = taxels.usable.reshape(n, -1), calibration.spreads.ravel()
    most = calibration.crosstalk + calibration.crosstalk_bound
    out = np.zeros((len(surface.sides), n), dtype=bool)
    for number, (side, inner) in enumerate(zip(surface.sides, surface.inner, strict=True)):
        on = np.flatnonzero(side)
        # Lines of cells stand in the same order; a side without a next line explains nothing.
        shown = np.zeros((n, len(on)))
        if inner.any():
            share = most * (1 + spread[on]) / (1 - spread[inner])
            shown = share * np.maximum(force[:, inner], 0.0)
        loaded = (force[:, on] > shown + doubt[:, on]) | ~seen[:, on]
        out[number] = (loaded & cells[:, on]).any(axis=1)
    return out


def _shown_together(taxels: TaxelForces) -> Bools:
    """Cells whose mean with their eight neighbours is above the noise: broad, weak load."""
    mean = uniform_filter(taxels.force_n, (3, 3), axes=(1, 2), mode="constant")
    noise = uniform_filter(taxels.noise_n, (3, 3), axes=(1, 2), mode="constant") / 3
    drift = uniform_filter(taxels.drift_n, (3, 3), axes=(1, 2), mode="constant")
    result: Bools = mean > BOUND_SIGMAS * noise + drift
    return result


def _hidden_n(taxels: TaxelForces, calibration: TipCalibration) -> Floats:
    """The most that each cell can bear without being seen, (n, r, c) N; inf if nothing says."""
    spread, doubt = calibration.spreads, taxels.doubt_n
    force = np.maximum(taxels.force_n, 0.0)
    high = np.where(taxels.usable, (force + doubt) / (1 - spread), np.inf)
    low = np.where(taxels.usable, np.maximum(force - doubt, 0.0) / (1 + spread), 0.0)
    shared = crosstalk_limit_n(high, calibration.crosstalk - calibration.crosstalk_bound)
    return np.minimum(shared, log_concave_limit_n(low, high))


def _position(
    taxels: TaxelForces, found: _Patch, hidden: Floats, surface: TaxelSurface, calibration: TipCalibration
) -> tuple[Floats, Floats]:
    """Centroid and its bounds, both (n, 3) mm."""
    n = len(hidden)
    force = taxels.force_n.reshape(n, -1)
    total = np.maximum(np.where(found.cells, force, 0.0).sum(axis=1), 1e-12)
    load = CellLoads(
        force_n=force,
        noise_n=taxels.noise_n.reshape(n, -1),
        drift_n=taxels.drift_n.reshape(n, -1),
        patch=found.cells,
        around=found.around,
        soft_n=taxels.doubt_n.max(axis=(1, 2)),
        gain_spread=np.broadcast_to(calibration.spreads.ravel(), force.shape),
    )
    places, bounds = [], []
    most = calibration.crosstalk + calibration.crosstalk_bound
    beyond_sides = _beyond_sides(taxels, found, hidden, surface, calibration)
    for axis in range(3):
        place, half = surface.place_mm[:, axis], float(surface.half_mm[axis])
        edge = sum(np.where(found.cells & side, force, 0.0).clip(min=0).sum(axis=1) for side in surface.sides)
        shift = most * 2 * half * np.asarray(edge) / total
        unseen = _unseen(found, hidden, surface, axis, beyond_sides)
        centre, bound = centroids(load, place, half, shift, unseen)
        places.append(centre)
        bounds.append(bound)
    return np.stack(places, axis=1), np.stack(bounds, axis=1)


def _unseen(
    found: _Patch, hidden: Floats, surface: TaxelSurface, axis: int, beyond_sides: list[tuple[Floats, Floats]]
) -> UnseenLoads:
    """Load on cells that cannot be seen, and beyond the array's four sides, along one axis."""
    place, half = surface.place_mm[:, axis], float(surface.half_mm[axis])
    n = len(hidden)
    blind = np.flatnonzero((hidden > 0).any(axis=0))
    most = [hidden[:, k] for k in blind]
    low = [np.full(n, place[k] - half) for k in blind]
    high = [np.full(n, place[k] + half) for k in blind]
    for side, (load, reach) in enumerate(beyond_sides):
        at = found.cells & surface.sides[side]
        hit = at.any(axis=1)
        least, largest = surface.step_mm[side, :, axis]
        first = np.where(at, place, np.inf).min(axis=1)
        last = np.where(at, place, -np.inf).max(axis=1)
        with np.errstate(invalid="ignore"):
            down = np.where(least < 0, least * (reach + 0.5), 0.0)
            up = np.where(largest > 0, largest * (reach + 0.5), 0.0)
        most.append(load)
        low.append(np.where(hit, first - half + down, 0.0))
        high.append(np.where(hit, last + half + up, 0.0))
    return UnseenLoads(np.stack(most, axis=1), np.stack(low, axis=1), np.stack(high, axis=1))


def _beyond_sides(
    taxels: TaxelForces, found: _Patch, hidden: Floats, surface: TaxelSurface, calibration: TipCalibration
) -> list[tuple[Floats, Floats]]:
    """Load beyond each side and its largest distance out, each (n,): N, cells."""
    n = len(found.cells)
    force, noise = taxels.force_n.reshape(n, -1), taxels.noise_n.reshape(n, -1)
    drift, spread = taxels.drift_n.reshape(n, -1), calibration.spreads.ravel()

    def line(at: Bools) -> tuple[Floats, Floats]:
        load = np.where(at, np.maximum(force, 0.0), 0.0)
        doubt = BOUND_SIGMAS * np.sqrt(np.where(at, noise**2 + (spread * load) ** 2 / 3, 0.0).sum(axis=1))
        return np.where(at, force, 0.0).sum(axis=1), doubt + np.where(at, drift, 0.0).sum(axis=1)

    sides = []
    for side, inner, cut in zip(surface.sides, surface.inner, found.cut, strict=True):
        outer_n, outer_doubt = line(found.around & side)
        inner_n, inner_doubt = line(found.around & inner)
        most = np.maximum(outer_n + outer_doubt, 0.0) + np.where(side, hidden, 0.0).sum(axis=1)
        load, reach = load_beyond_edge(np.where(cut, most, 0.0), np.maximum(inner_n - inner_doubt, 0.0))
        sides.append((load, reach))
    return sides


def _directions(force: Floats, found: _Patch, surface: TaxelSurface) -> tuple[Floats, Floats, Floats]:
    """Middle and half of the range of directions, and the patch's width, each (n,) rad."""
    n = len(force)
    if surface.flat:
        return np.full(n, -math.pi / 2), np.full(n, math.pi / 2), np.zeros(n)
    weight = np.where(found.cells, np.maximum(force, 0.0), 0.0)
    azimuth = np.nan_to_num(surface.azimuth_rad)
    middle = np.arctan2(weight @ np.sin(azimuth), weight @ np.cos(azimuth))
    away = wrap_angle(azimuth[None, :] - middle[:, None])
    low = np.where(found.cells, away, np.inf).min(axis=1)
    high = np.where(found.cells, away, -np.inf).max(axis=1)
    if surface.turn_rad < _FLAT_RAD:  # free by its description, but flat all the same
        return middle, np.full(n, math.pi / 2), np.zeros(n)
    step = surface.turn_rad / 2
    beyond = np.where(found.cut, surface.turns_rad[:, None] / 2, 0.0).max(axis=0)
    margin = np.maximum(_MAX_STEPS_BEYOND_EDGE * beyond, step)
    upright = (found.cells & np.isnan(surface.azimuth_rad)).any(axis=1)
    half = np.where(upright, math.pi, np.minimum((high - low) / 2 + margin, math.pi))
    return middle + (low + high) / 2, half, high - low + 2 * step


def _flags(found: _Patch, seen: Bools, full: Bools) -> Ints:
    """Bits of `PatchFlag`, (n,)."""
    cut = found.cut.any(axis=0)
    single = (found.cells & seen).sum(axis=1) == 1
    saturated = (found.around & full).any(axis=1)
    dead = (found.around & ~seen & ~full).any(axis=1)
    result: Ints = (
        PatchFlag.TRUNCATED.bit * cut
        + PatchFlag.SATURATED.bit * saturated
        + PatchFlag.SINGLE_TAXEL.bit * single
        + PatchFlag.SEVERAL_PATCHES.bit * found.others.any(axis=1)
        + PatchFlag.DEAD_NEIGHBOUR.bit * dead
    )
    return result


def _force_bound(taxels: TaxelForces, found: _Patch, hidden: Floats, calibration: TipCalibration) -> Floats:
    """Bound of the force (n,) N: gains, noise, drift and unseen cells."""
    n, spread = len(hidden), calibration.spreads.ravel()
    force = taxels.force_n.reshape(n, -1)
    noise_n, drift_n = taxels.noise_n.reshape(n, -1), taxels.drift_n.reshape(n, -1)
    patch = np.where(found.around, np.maximum(force, 0.0), 0.0)
    wrong = patch * (spread / (1 - spread))
    gains = wrong.sum(axis=1)
    if not calibration.is_common:
        gains = np.minimum(BOUND_SIGMAS / math.sqrt(3) * np.sqrt((wrong**2).sum(axis=1)), gains)
    noise = BOUND_SIGMAS * np.sqrt(np.where(found.around, noise_n**2, 0.0).sum(axis=1))
    drift = np.where(found.around, drift_n, 0.0).sum(axis=1)
    bound: Floats = gains + noise + drift + hidden.sum(axis=1)
    return bound
