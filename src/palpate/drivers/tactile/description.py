"""Description of a tactile array: shape, scale, place of every taxel; mounting of a matrix; surface cells.

The tip frame has z along the tip's axis, pointing up, z = 0 at the tip's lower end; angle 0 is the array's
middle, counter-clockwise seen from above. An array says this of itself, or, where it knows its cells only,
the rig file says how they are mounted and the driver makes the description with it. `TaxelSurface` has the
taxels as cells: places, sizes and sides.
"""

import enum
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

from palpate.base.errors import DeviceError
from palpate.base.geometry import Bools, Counts, Floats
from palpate.base.geometry.plane import wrap_angle

Matrix = TypeVar("Matrix", Counts, Floats)

MAX_TAXELS = 4096
REALS_PER_TAXEL = 6
_NORMAL_TOLERANCE = 0.01

# What lies outside of these is a mistake in the firmware, such as degrees for radians, and no array.
_RATES_HZ = (0.001, 4294967.295)
_FULL_SCALES_N = (1e-3, 1e5)
COUNTS_PER_N = (1e-3, 1e7)
RADII_MM = (0.1, 1000.0)
_MAX_COORDINATE_MM = 1000.0
_HALF_TURN_RAD = 3.1416  # half a turn, and what rounding adds
_MIN_PITCH_MM = 0.01
_MIN_PITCH_RAD = 1e-4


class Shape(enum.IntEnum):
    """Surface that carries the taxels."""

    FLAT = 0
    CYLINDER = 1
    FREE = 2


@dataclass(frozen=True)
class Description:
    """Description that an array gives of itself. Reals travel as 32-bit floats.

    `columns` holds one position per column, ascending: rad about the tip's axis on a cylinder, mm along x on
    a flat pad. `row_heights_mm` holds one z per row, ascending. Both are empty on a free surface; there
    `geometry` holds six reals a taxel, row by row: position x, y, z (mm) and outward unit normal x, y, z, in
    the tip frame. It does not travel with DESCRIBE and is empty until it has been fetched.
    `full_scale_n` is the force on one taxel that brings it to its largest count. `tip_radius_mm` is 0 for
    a flat or free array.
    """

    unique_id: bytes
    firmware: str
    emulated: bool
    shape: Shape
    rows: int
    cols: int
    bit_depth: int
    max_rate_hz: float
    full_scale_n: float
    counts_per_n: float
    tip_radius_mm: float
    columns: tuple[float, ...]
    row_heights_mm: tuple[float, ...]
    geometry: tuple[float, ...] = ()

    @property
    def max_count(self) -> int:
        """Largest value a taxel can have."""
        return (1 << self.bit_depth) - 1

    @property
    def taxels(self) -> int:
        """Number of taxels."""
        return self.rows * self.cols

    def counted_from(self, first: "Corner") -> "Description":
        """The description of an array that counts from another corner than it says; a free one knows."""
        if self.shape is Shape.FREE:
            return self
        columns, rows = self.columns, self.row_heights_mm
        if first.value.endswith("right"):
            columns = tuple(-at for at in reversed(columns))
        if first.value.startswith("upper"):
            rows = tuple(rows[0] + rows[-1] - at for at in reversed(rows))
        return replace(self, columns=columns, row_heights_mm=rows)

    def positions_mm(self) -> Floats:
        """Taxel centres, shape (rows, cols, 3), mm, tip frame.

        Raises DeviceError if the array is free and its geometry has not been fetched.
        """
        if self.shape is Shape.FREE:
            return self._places()[..., :3]
        columns = np.asarray(self.columns)
        flat = self.shape is Shape.FLAT
        x = columns if flat else self.tip_radius_mm * np.cos(columns)
        y = np.zeros(self.cols) if flat else self.tip_radius_mm * np.sin(columns)
        out = np.empty((self.rows, self.cols, 3))
        out[..., 0], out[..., 1] = x, y
        out[..., 2] = np.asarray(self.row_heights_mm)[:, None]
        return out

    def normals(self) -> Floats:
        """Outward unit normals of the taxels, shape (rows, cols, 3), tip frame.

        Raises DeviceError if the array is free and its geometry has not been fetched.
        """
        if self.shape is Shape.FREE:
            normals = self._places()[..., 3:]
            unit: Floats = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
            return unit
        angles = np.full(self.cols, -math.pi / 2) if self.shape is Shape.FLAT else np.asarray(self.columns)
        out = np.zeros((self.rows, self.cols, 3))
        out[..., 0], out[..., 1] = np.cos(angles), np.sin(angles)
        return out

    def _places(self) -> Floats:
        if not self.geometry:
            raise DeviceError(
                f"the places of the {self.taxels} taxels of array {self.unique_id.hex()} are not known; "
                "its surface is free: fetch its geometry first, as TactileArray.connect() does"
            )
        return np.reshape(np.asarray(self.geometry), (self.rows, self.cols, REALS_PER_TAXEL))

    def problem(self) -> str | None:
        """Name the first field that cannot be used, its value and what is allowed; None if all can be."""
        return next(filter(None, self._problems()), None)

    def _problems(self) -> Iterator[str | None]:
        yield (
            None if len(self.unique_id) == 16 else f"a unique id of {len(self.unique_id)} bytes (allowed: 16)"
        )
        yield _range_problem("rows", self.rows, 1, 255)
        yield _range_problem("columns", self.cols, 1, 255)
        yield _range_problem(f"{self.rows} x {self.cols} taxels, together", self.taxels, 1, MAX_TAXELS)
        yield _range_problem("bit depth", self.bit_depth, 1, 16)
        yield _range_problem("maximum rate", self.max_rate_hz, *_RATES_HZ, "Hz")
        yield _range_problem("full scale", self.full_scale_n, *_FULL_SCALES_N, "N")
        yield _range_problem("counts per N", self.counts_per_n, *COUNTS_PER_N)
        least_mm = RADII_MM[0] if self.shape is Shape.CYLINDER else 0.0
        yield _range_problem("tip radius", self.tip_radius_mm, least_mm, RADII_MM[1], "mm")
        yield _range_problem("bytes of firmware name", len(self.firmware.encode()), 0, 255)
        yield from self._free_problems() if self.shape is Shape.FREE else self._grid_problems()

    def _grid_problems(self) -> Iterator[str | None]:
        cylinder = self.shape is Shape.CYLINDER
        farthest, nearest, unit = (
            (_HALF_TURN_RAD, _MIN_PITCH_RAD, "rad") if cylinder else (_MAX_COORDINATE_MM, _MIN_PITCH_MM, "mm")
        )
        yield _count_problem("column positions", len(self.columns), self.cols)
        yield _position_problem("column", self.columns, farthest, nearest, unit)
        yield _count_problem("row heights", len(self.row_heights_mm), self.rows)
        yield _position_problem("row", self.row_heights_mm, _MAX_COORDINATE_MM, _MIN_PITCH_MM, "mm")
        yield "a place of its own for each taxel (allowed: on a free surface)" if self.geometry else None

    def _free_problems(self) -> Iterator[str | None]:
        if self.columns or self.row_heights_mm:
            yield "column positions or row heights (allowed: on a surface that is not free)"
        if self.geometry:
            yield _count_problem("reals of geometry", len(self.geometry), REALS_PER_TAXEL * self.taxels)
            yield geometry_problem(self.geometry)


def geometry_problem(reals: tuple[float, ...]) -> str | None:
    """Say what is wrong with places of taxels, six reals each, or None if nothing is."""
    places = np.reshape(np.asarray(reals, dtype=np.float64), (-1, REALS_PER_TAXEL))
    off = ~(np.abs(places[:, :3]) <= _MAX_COORDINATE_MM)
    if off.any():
        value = places[:, :3][off][0]
        allowed = f"{-_MAX_COORDINATE_MM:g} to {_MAX_COORDINATE_MM:g} mm"
        return f"a taxel's position of {value:g} mm (allowed: {allowed})"
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(places[:, 3:], axis=1)
    wrong = ~(np.abs(length - 1) <= _NORMAL_TOLERANCE)
    return (
        f"a taxel's normal of length {length[wrong][0]:.4g} (allowed: 1 within 1 %)" if wrong.any() else None
    )


def _range_problem(what: str, value: float, lo: float, hi: float, unit: str = "") -> str | None:
    unit = f" {unit}" if unit else ""
    return None if lo <= value <= hi else f"{what} {value:.7g}{unit} (allowed: {lo:.7g} to {hi:.7g}{unit})"


def _count_problem(what: str, count: int, wanted: int) -> str | None:
    return None if count == wanted else f"{count} {what} (allowed: {wanted})"


def _position_problem(
    what: str, values: tuple[float, ...], farthest: float, nearest: float, unit: str
) -> str | None:
    """Problem of the positions of columns or rows; the first has number 0."""
    for number, value in enumerate(values):
        if not -farthest <= value <= farthest:
            return _range_problem(f"{what} {number} at", value, -farthest, farthest, unit)
    for number, (before, value) in enumerate(pairwise(values), 1):
        if not value - before >= nearest:
            return (
                f"{what} {number} at {value:.7g} {unit} after one at {before:.7g} {unit} "
                f"(allowed: ascending, {nearest:g} {unit} apart or more)"
            )
    return None


class Corner(enum.Enum):
    """Corner of the tip at which a matrix begins, seen from outside with the tip's axis upright."""

    LOWER_LEFT = "lower-left"
    LOWER_RIGHT = "lower-right"
    UPPER_LEFT = "upper-left"
    UPPER_RIGHT = "upper-right"

    def flip(self, taxels: Matrix) -> Matrix:
        """A matrix that begins at this corner, beginning at the lower left one, and the other way round."""
        rows = slice(None, None, -1 if self in (Corner.UPPER_LEFT, Corner.UPPER_RIGHT) else 1)
        cols = slice(None, None, -1 if self in (Corner.LOWER_RIGHT, Corner.UPPER_RIGHT) else 1)
        return taxels[rows, cols]


@dataclass(frozen=True)
class Mounting:
    """A matrix on a tip.

    `counts_per_n`: what a force of 1 N on one taxel adds to its count. `first`: where its first texel is;
    `upright`: its rows run along the tip's axis, not across.
    """

    shape: Shape
    tip_radius_mm: float
    counts_per_n: float
    first: Corner = Corner.LOWER_LEFT
    upright: bool = False

    def to_tip(self, cells: Counts) -> Counts:
        """Convert the device's matrix (its rows, its columns) to the tip's (rows, columns)."""
        return np.ascontiguousarray(self.first.flip(cells.T if self.upright else cells))

    def to_device(self, taxels: Counts) -> Counts:
        """The other way round."""
        flipped = self.first.flip(taxels)
        return np.ascontiguousarray(flipped.T if self.upright else flipped)

    def pitch(self, texel_mm: tuple[float, float]) -> tuple[float, float]:
        """Distance of columns (rad; mm on a pad) and of rows (mm), from a texel's size in x and y."""
        along, up = texel_mm[::-1] if self.upright else texel_mm
        return (along if self.shape is Shape.FLAT else along / self.tip_radius_mm), up

    def describe(
        self,
        cells: tuple[int, int],
        texel_mm: tuple[float, float],
        *,
        unique_id: bytes,
        firmware: str,
        emulated: bool,
        bit_depth: int,
        max_rate_hz: float,
    ) -> Description:
        """Description of a matrix of `cells` (x, y), texels of `texel_mm` (x, y), that sits like this.

        Raises ValueError if it cannot: no cells, or more than go round the tip.
        """
        cols, rows = cells[::-1] if self.upright else cells
        along, up = self.pitch(texel_mm)
        if self.shape is Shape.CYLINDER and cols * along > 2 * math.pi * 1.01:
            raise ValueError(
                f"{cols} columns of {along * self.tip_radius_mm:.2f} mm do not fit round a tip "
                f"of radius {self.tip_radius_mm:g} mm"
            )
        found = Description(
            unique_id=unique_id[:16].ljust(16, b"\0"),
            firmware=firmware,
            emulated=emulated,
            shape=self.shape,
            rows=rows,
            cols=cols,
            bit_depth=bit_depth,
            max_rate_hz=max_rate_hz,
            full_scale_n=((1 << bit_depth) - 1) / self.counts_per_n,
            counts_per_n=self.counts_per_n,
            tip_radius_mm=0.0 if self.shape is Shape.FLAT else self.tip_radius_mm,
            columns=tuple((k - (cols - 1) / 2) * along for k in range(cols)),
            row_heights_mm=tuple((k + 0.5) * up for k in range(rows)),
        )
        problem = found.problem()
        if problem is not None:
            raise ValueError(problem)
        return found


@dataclass(frozen=True, eq=False)
class TaxelSurface:
    """k = rows · cols cells in the tip frame, row by row.

    `place_mm` (k, 3) are their middles; within `half_mm` (3,) of it, by axis, a cell's load lies. `area_mm2`
    (k,). `azimuth_rad` (k,) is where their normals point, nan where they point up or down; neighbours differ
    by at most `turn_rad`. `sides` (4, k): cells on the first and last column, on the first and last row;
    `inner` (4, k): cells on the line next to each, none where there is no other line. `step_mm` (4, 2, 3):
    least and largest step outward from there to the side, by axis. `turns_rad` (4,): the most that normals
    turn about the tip's axis from one line to the next, across the array that way, or may.
    """

    flat: bool
    place_mm: Floats
    half_mm: Floats
    area_mm2: Floats
    azimuth_rad: Floats
    turn_rad: float
    sides: Bools
    inner: Bools
    step_mm: Floats
    turns_rad: Floats


def surface_of(description: Description) -> TaxelSurface:
    """The cells of a flat or free array."""
    d = description
    place = d.positions_mm()
    normal = d.normals()
    steps = [np.abs(np.diff(place, axis=axis)).reshape(-1, 3) for axis in (0, 1)]
    half = np.concatenate([*steps, np.zeros((1, 3))]).max(axis=0) / 2
    length = [np.linalg.norm(np.diff(place, axis=axis), axis=2) for axis in (0, 1)]
    size = [float(each.mean()) if each.size else 0.0 for each in length]
    side = [each if each else max(size) for each in size]
    level = np.hypot(normal[..., 0], normal[..., 1])
    azimuth = np.where(level > 0.2, np.arctan2(normal[..., 1], normal[..., 0]), np.nan)
    turns = [np.abs(wrap_angle(np.diff(azimuth, axis=axis))).ravel() for axis in (1, 0)]
    most = float(np.nanmax(np.concatenate([*turns, np.zeros(1)])))
    # A single line of cells, or normals that point up, do not say how they go on.
    side_turns = [float(each.max()) if each.size and not np.isnan(each).any() else most for each in turns]
    row, col = np.indices((d.rows, d.cols)).reshape(2, -1)
    return TaxelSurface(
        flat=d.shape is Shape.FLAT,
        place_mm=place.reshape(-1, 3),
        half_mm=half,
        area_mm2=np.full(d.taxels, side[0] * side[1]),
        azimuth_rad=azimuth.ravel(),
        turn_rad=most,
        sides=np.stack([col == 0, col == d.cols - 1, row == 0, row == d.rows - 1]),
        inner=np.stack([col == 1, col == d.cols - 2, row == 1, row == d.rows - 2]),
        step_mm=np.stack(
            [
                _steps(place[:, :2, :], 1),
                _steps(place[:, :-3:-1, :], 1),
                _steps(place[:2], 0),
                _steps(place[:-3:-1], 0),
            ]
        ),
        turns_rad=np.repeat(side_turns, 2),
    )


def _steps(pair: Floats, axis: int) -> Floats:
    """Least and largest step (2, 3) outward, from the second line of cells to the first, both in `pair`."""
    steps = -np.diff(pair, axis=axis).reshape(-1, 3)
    return np.stack([steps.min(axis=0), steps.max(axis=0)]) if len(steps) else np.zeros((2, 3))
