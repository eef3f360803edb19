"""Contact patches: what the contact extractor returns, for one frame or for each frame of a recording.

The values between `contact` and those who use it. Tip frame throughout: z along the tip's axis, upwards, 0 at
the tip's lower end; angle 0 at the array's middle, counter-clockwise seen from above.
"""

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from palpate.base.geometry import Bools, Floats, Ints


class PatchFlag(enum.Enum):
    """Circumstance that a patch's bounds had to allow for."""

    TRUNCATED = "cut by the array's edge"
    SATURATED = "a taxel is at its largest count"
    SINGLE_TAXEL = "one column only"
    SEVERAL_PATCHES = "touched in several places; this is the strongest"
    WIDE = "wider than one edge explains: probably two edges in a notch"
    DEAD_NEIGHBOUR = "a dead or hot taxel in or beside the patch"
    EDGES_UNKNOWN = "one edge or more: the contact source does not say"

    @property
    def bit(self) -> int:
        """The flag's bit in `Patches.flags`."""
        return 1 << list(PatchFlag).index(self)


@dataclass(frozen=True, eq=False)
class TipCalibration:
    """Calibration of one tip.

    `gain`: relative gain per taxel, shape (rows, cols), 1 where unknown; `gain_spread`: share of it that it
    is off by at most, the same for all taxels or (rows, cols). `noise_counts`: standard deviation of one
    count. `contact_force_n`: less than this is no contact. `stiffness_bound` and `crosstalk_bound` are the
    half-widths of `stiffness_n_per_mm` (relative) and `crosstalk` (absolute; share of a taxel's force that
    each neighbour takes). `usable`: False for taxels known to be dead or hot. `drift_counts_per_s`: no
    taxel's zero moves faster; 0 leaves zeros as they were when tared. `force_drift_n_per_s`: neither does
    the zero of what usable taxels of any `WINDOW_COLUMNS` neighbouring columns show together; None: unknown.
    `is_common`: the gains of all taxels may be off by the same, as where they depend on force or its past.
    """

    gain: Floats
    gain_spread: float | Floats = 0.2
    noise_counts: float = 2.0
    contact_force_n: float = 0.1
    stiffness_n_per_mm: float = 3.0
    stiffness_bound: float = 0.2
    crosstalk: float = 0.075
    crosstalk_bound: float = 0.03
    usable: Bools | None = None
    drift_counts_per_s: float = 0.0
    force_drift_n_per_s: float | None = None
    is_common: bool = False

    @property
    def spreads(self) -> Floats:
        """`gain_spread` of every taxel, (rows, cols)."""
        return np.broadcast_to(np.asarray(self.gain_spread, dtype=np.float64), self.gain.shape)


@dataclass(frozen=True)
class ContactPatch:
    """A touched place on the tip, in the tip frame.

    The object's outward normal points from the object to the tip: it is opposite to `angle_rad`. The
    direction from the tip's axis to the contact is within `angle_rad` ± `angle_half_range_rad`; in a notch
    that holds for at least one of the edges. On a flat array the normal is unknown by nature: the range is
    the half circle in front of the pad.

    `position_mm` is the centroid of the load on the surface, x, y, z, each within `position_bound_mm` (inf
    where the array's edge cuts the patch and nothing bounds it). `centroid_rad` ± `centroid_bound_rad` is its
    direction on a cylinder, nan on a flat array; `height_mm` ± `height_bound_mm` its height over the tip's
    lower end. `pressed_mm`: on a flat array, two ranges of x in each of which something certainly presses,
    the first and the last; None where that is not known. `loaded_mm`: the range of x outside of which such an
    array shows nothing. `force_n` is what the array sees of this patch, within `force_bound_n` (inf if taxels
    are saturated). `extent_rad` is the width of the active patch, 0 on a flat array, `area_mm2` that of its
    loaded taxels.
    """

    angle_rad: float
    angle_half_range_rad: float
    centroid_rad: float
    centroid_bound_rad: float
    position_mm: tuple[float, float, float]
    position_bound_mm: tuple[float, float, float]
    height_mm: float
    height_bound_mm: float
    force_n: float
    force_bound_n: float
    extent_rad: float
    area_mm2: float
    pressed_mm: tuple[tuple[float, float], tuple[float, float]] | None = None
    loaded_mm: tuple[float, float] | None = None
    flags: frozenset[PatchFlag] = field(default_factory=frozenset)


@dataclass(frozen=True, eq=False)
class Patches:
    """The patches of n frames, each field with n rows. See `ContactPatch` for what they mean.

    Where `touched` is False there is no contact, and the other rows are nan, and 0 in `flags` (bits of
    `PatchFlag.bit`).
    """

    touched: Bools
    angle_rad: Floats
    angle_half_range_rad: Floats
    centroid_rad: Floats
    centroid_bound_rad: Floats
    position_mm: Floats
    position_bound_mm: Floats
    height_mm: Floats
    height_bound_mm: Floats
    force_n: Floats
    force_bound_n: Floats
    extent_rad: Floats
    area_mm2: Floats
    pressed_mm: Floats
    loaded_mm: Floats
    flags: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.touched)

    def patch(self, index: int) -> ContactPatch | None:
        """The patch of one frame, None if nothing was touched."""
        if not self.touched[index]:
            return None
        said = {f.name: getattr(self, f.name)[index].tolist() for f in fields(ContactPatch)}
        said["position_mm"], said["position_bound_mm"] = map(
            tuple, (said["position_mm"], said["position_bound_mm"])
        )
        first, last = said["pressed_mm"]
        said["pressed_mm"] = None if math.isnan(first[0]) else (tuple(first), tuple(last))
        said["loaded_mm"] = None if math.isnan(said["loaded_mm"][0]) else tuple(said["loaded_mm"])
        said["flags"] = frozenset(flag for flag in PatchFlag if int(self.flags[index]) & flag.bit)
        return ContactPatch(**said)


def mask_untouched(patches: Patches) -> Patches:
    """The same with nan, and no flags, in frames without contact."""
    touched = patches.touched
    values = {f.name: getattr(patches, f.name) for f in fields(Patches)}
    masked = {
        name: np.where(touched.reshape(-1, *[1] * (value.ndim - 1)), value, np.nan)
        for name, value in values.items()
    }
    flags = np.where(touched, patches.flags, 0).astype(np.uint8)
    return Patches(**(masked | {"touched": touched, "flags": flags}))


def scatter_patches(patches: Patches, rows: Ints, count: int) -> Patches:
    """The same as rows of `count` frames, of which the others are not touched."""
    out = empty_patches(count)
    for f in fields(Patches):
        getattr(out, f.name)[rows] = getattr(patches, f.name)
    return out


def empty_patches(count: int) -> Patches:
    """`count` frames in which nothing is touched."""
    nothing = {f.name: np.full(count, np.nan) for f in fields(Patches)}
    sides = {name: np.full((count, 3), np.nan) for name in ("position_mm", "position_bound_mm")}
    sides |= {"pressed_mm": np.full((count, 2, 2), np.nan), "loaded_mm": np.full((count, 2), np.nan)}
    return Patches(
        **{**nothing, **sides, "touched": np.zeros(count, bool), "flags": np.zeros(count, np.uint8)}
    )


def concatenate_patches(pieces: Sequence[Patches]) -> Patches:
    """One after the other."""
    return Patches(**{f.name: np.concatenate([getattr(p, f.name) for p in pieces]) for f in fields(Patches)})
