"""Contact sources: devices that report contacts by themselves, each value with its bound.

What is above asks for patches, forces and zeros as of an array: a source is one of a single taxel, its force.
Its bounds are taken as they come, or as the rig file widens them. Errors may be held for as long as a touch
lasts, so that no mean of readings is nearer to the truth than one of them.
"""

import math
from collections.abc import Sequence

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import wrap_angle
from palpate.drivers.tactile.baseline import BOUND_SIGMAS, Baseline
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.frames import ContactReading, DecodedFrame, TactileFrame
from palpate.drivers.tactile.patches import ContactPatch, PatchFlag, TipCalibration

_COUNTS_PER_N = 1000.0
_BIT_DEPTH = 16
_STAMP_S = 1e-6  # unit of stamps, as of all free-running arrays


def source_description(name: str, rate_hz: float, *, emulated: bool) -> Description:
    """Description of a source that reports `rate_hz` times a second; `name`: of what it speaks."""
    return Description(
        unique_id=name.encode()[:16].ljust(16, b"\0"),
        firmware=name,
        emulated=emulated,
        shape=Shape.FREE,
        rows=1,
        cols=1,
        bit_depth=_BIT_DEPTH,
        max_rate_hz=rate_hz,
        full_scale_n=((1 << _BIT_DEPTH) - 1) / _COUNTS_PER_N,
        counts_per_n=_COUNTS_PER_N,
        tip_radius_mm=0.0,
        columns=(),
        row_heights_mm=(),
    )


def source_frame(reading: ContactReading) -> DecodedFrame:
    """The frame of a reading, stamped if it has a time; its counts are the force."""
    count = min(max(round(reading.force_n * _COUNTS_PER_N), 0), (1 << _BIT_DEPTH) - 1)
    stamp = None if reading.time_s is None else round(reading.time_s / _STAMP_S) % (1 << 32)
    return DecodedFrame(np.array([[count]], dtype=np.uint16), stamp, reading)


class SourceExtractor(ContactExtractor):
    """Patches of the readings of a contact source, none of which is trusted beyond the stated bounds."""

    def __init__(self, description: Description, angle_bound_rad: float, force_bound_n: float) -> None:
        super().__init__(description, TipCalibration(np.ones((1, 1)), gain_spread=0.0, noise_counts=0.0))
        self._angle_bound_rad, self._force_bound_n = angle_bound_rad, force_bound_n
        self._at_rest: ContactReading | None = None
        self._doubt_n = self._rest_bound_n = force_bound_n

    def tare(self, frames: Sequence[TactileFrame]) -> Baseline:
        """Keep the zero, which is the source's own; note how well it is known, and what contradicts it."""
        readings = [_contact_of(frame) for frame in frames]
        self._at_rest = max(readings, key=lambda reading: reading.force_n - self._force_bound(reading))
        self._rest_bound_n = max(map(self._force_bound, readings))
        noise = self._rest_bound_n * _COUNTS_PER_N / BOUND_SIGMAS
        self._use(Baseline(np.zeros((1, 1)), noise, np.ones((1, 1), dtype=bool)))
        return self.baseline

    def threshold_problem(self, contact_force_n: float) -> str | None:
        """Why contacts above a threshold cannot be told from none, by the last tare; None if they can."""
        rest = self._at_rest
        if rest is not None and rest.force_n > self._force_bound(rest):
            return (
                f"it reports {rest.force_n:.2g} ± {self._force_bound(rest):.2g} N, and nothing should touch "
                "its tip; see what presses there, and if nothing does, let the source take its zero anew"
            )
        if self._rest_bound_n <= contact_force_n:
            return None
        return (
            f"it knows its force within ± {self._rest_bound_n:.2g} N only, which would hide or pass for a "
            f"contact of contact_force_n = {contact_force_n:g} N; use {self._rest_bound_n:.2g} N at least"
        )

    def sense(self, frame: TactileFrame) -> tuple[float, Floats]:
        """The force (N) that certainly presses, else 0; and the force as read, (1,)."""
        reading = _contact_of(frame)
        self._doubt_n = self._force_bound(reading)
        force_n = reading.force_n if reading.force_n > self._doubt_n else 0.0
        return force_n, np.array([reading.force_n])

    def steady_force_n(self, readings: Floats, frames: int) -> float:  # noqa: ARG002
        """Force (N) in the mean of some frames, if it certainly presses."""
        mean_n = float(readings[0])
        return mean_n if mean_n > self._doubt_n else 0.0

    @property
    def zero_doubt_n(self) -> tuple[float, float]:
        """Force (N) that the reading sensed last may hide, either way."""
        return self._doubt_n, self._doubt_n

    @property
    def least_force_n(self) -> float:
        """Least threshold (N) that no reading exceeds untouched."""
        return self._rest_bound_n

    def noise_share(self, frames: int) -> float:  # noqa: ARG002
        """Return 1: errors may be the same in all frames."""
        return 1.0

    def extract(self, frames: TactileFrame | Sequence[TactileFrame]) -> ContactPatch | None:
        """The contact in the mean of readings of one touch; None if none of them certainly touches.

        The mean of values that are each within a bound of the truth is within the mean of these bounds.
        """
        group = [frames] if isinstance(frames, TactileFrame) else frames
        readings = [_contact_of(frame) for frame in group]
        touching = [reading for reading in readings if reading.force_n > self._force_bound(reading)]
        if not touching:
            return None
        angle_rad, half_rad = self._mean_angle(touching)
        heights = [
            (item.height_mm, item.height_bound_mm) for item in touching if not math.isnan(item.height_mm)
        ]
        height_mm, height_bound_mm = _mean(heights) if heights else (math.nan, math.inf)
        force_n, force_bound_n = _mean([(item.force_n, self._force_bound(item)) for item in readings])
        return ContactPatch(
            angle_rad=angle_rad,
            angle_half_range_rad=half_rad,
            centroid_rad=math.nan,
            centroid_bound_rad=math.pi,
            position_mm=(math.nan, math.nan, height_mm),
            position_bound_mm=(math.inf, math.inf, height_bound_mm),
            height_mm=height_mm,
            height_bound_mm=height_bound_mm,
            force_n=force_n,
            force_bound_n=force_bound_n,
            extent_rad=0.0,
            area_mm2=0.0,
            flags=frozenset({PatchFlag.EDGES_UNKNOWN}),
        )

    def _force_bound(self, reading: ContactReading) -> float:
        return max(reading.force_bound_n, self._force_bound_n)

    def _mean_angle(self, readings: Sequence[ContactReading]) -> tuple[float, float]:
        """Mean direction and half range, all round the tip where no reading knows it."""
        known = [
            (max(item.angle_half_range_rad, self._angle_bound_rad), item.angle_rad)
            for item in readings
            if not math.isnan(item.angle_rad)
        ]
        narrow = [item for item in known if item[0] < math.pi / 2]  # these do not differ by half a turn
        if not narrow:
            half_rad, angle_rad = min(known, default=(math.pi, 0.0))
            return wrap_angle(angle_rad), min(half_rad, math.pi)
        first_rad = narrow[0][1]
        off_rad, half_rad = _mean([(wrap_angle(angle_rad - first_rad), half) for half, angle_rad in narrow])
        return wrap_angle(first_rad + off_rad), half_rad


def _contact_of(frame: TactileFrame) -> ContactReading:
    assert frame.contact is not None, "a frame of a contact source without a reading"
    return frame.contact


def _mean(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean of some values, and of their bounds."""
    value, bound = np.mean(values, axis=0).tolist()
    return value, bound
