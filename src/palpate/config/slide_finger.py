"""Rig file table of an aim and slide finger, type "slide": its keys, its geometry, and its calibration."""

import math
from typing import Literal, Self

from pydantic import Field

from palpate.config.calibration_finger import ActuatorsCalibration, ContactBounds, PlaceCalibration
from palpate.config.emulation import MechanicsConfig
from palpate.config.problems import problem
from palpate.config.rig_fingers import BOUND_SIGMAS, FingerConfig
from palpate.config.rig_servos import AimConfig, SlideConfig

_MIN_FRICTION_SHARE = 0.8
"""Of a slide's measured friction: it becomes less as grease warms and parts wear in."""


class SlideFingerConfig(FingerConfig):
    """One finger: an aim servo turns a slide about a fixed base, a slide servo moves the tip along it."""

    type: Literal["slide"] = Field(default="slide", description='"slide": an aim and a slide.')
    aim: AimConfig
    slide: SlideConfig

    drawn_within = (
        ("backlash_mm", "slide.backlash_mm"),
        ("aim_backlash_deg", "aim.backlash_deg"),
        ("zero_error_mm", "slide.zero_bound_mm"),
        ("mm_per_turn_error", "slide.mm_per_turn_spread"),
    )
    calibrated_by = (ActuatorsCalibration, PlaceCalibration)
    no_calibration = "has an aim and a slide, and the calibration is an arm's"

    @property
    def servos(self) -> dict[str, AimConfig | SlideConfig]:
        """Both servos by their keys, the one next to the base first."""
        return {"aim": self.aim, "slide": self.slide}

    @property
    def lever_mm(self) -> float:
        """Distance of the extended tip from the aim's axis."""
        return self.slide.range_mm[1]

    @property
    def stops_mm(self) -> tuple[float, float] | None:
        """Hard stops of the slide."""
        return self.slide.stops_mm

    def start_tip_mm(self, _radius_mm: float) -> tuple[float, float]:
        """Tip centre, retracted at aim 0."""
        heading, distance = math.radians(self.heading_deg), self.slide.range_mm[0]
        return (
            self.base_mm[0] + distance * math.cos(heading),
            self.base_mm[1] + distance * math.sin(heading),
        )

    def check_place(self, radius_mm: float, *at: str | int) -> None:
        """Refuse a slide that waits in the workspace, or never gets there."""
        waiting = self._nearest_to_origin(self.slide.range_mm[0])
        needed = radius_mm + self.tip.half_width_mm
        if waiting < needed:
            raise problem(
                f"retracted to {self.slide.range_mm[0]:g} mm the tip's centre comes within {waiting:.4g} "
                f"mm of the origin; it must wait {needed:g} mm away (workspace.radius_mm + tip.radius_mm)",
                *(*at, "slide", "range_mm"),
            )
        reach = self._nearest_to_origin(self.slide.range_mm[1])
        if reach >= needed:
            raise problem(
                f"the tip's centre stays {reach:.4g} mm or more from the origin, never in the workspace; "
                "check base_mm, heading_deg and slide.range_mm",
                *at,
            )

    def _nearest_to_origin(self, extent_mm: float) -> float:
        """Least distance of the tip centre from W's origin over the aim range, slid out to `extent_mm`."""
        x, y = self.base_mm
        to_origin = math.hypot(x, y)
        inward = math.degrees(math.atan2(-y, -x)) - self.heading_deg
        lo, hi = self.aim.range_deg
        first = lo + (inward - lo) % 360
        aims = (first,) if first <= hi else (lo, hi)
        distances = []
        for aim in aims:
            angle = math.radians(self.heading_deg + aim)
            along = -x * math.cos(angle) - y * math.sin(angle)
            slide = min(max(along, self.slide.range_mm[0]), extent_mm)
            distances.append(math.sqrt(max(to_origin**2 + slide**2 - 2 * slide * along, 0.0)))
        return min(distances)

    def give_mm_per_n(self, mechanics: MechanicsConfig | None) -> float:
        """Largest emulated give of the slide."""
        drawn = mechanics and mechanics.slide_deflection_mm_per_n
        return drawn[1] if drawn else 0.0

    def with_actuators(self, found: ActuatorsCalibration) -> Self:
        """The finger with calibrated slide and aim."""
        slide, aim = found.slide, found.aim
        changes: dict[str, float] = {
            "backlash_mm": slide.backlash_mm + BOUND_SIGMAS * slide.backlash_sigma_mm,
            "friction_a": _MIN_FRICTION_SHARE * slide.friction_a,
        }
        if slide.homed:
            changes |= {
                "zero_mm": slide.zero_mm,
                "zero_bound_mm": BOUND_SIGMAS * slide.zero_sigma_mm,
                "mm_per_turn": slide.mm_per_turn,
                "mm_per_turn_spread": BOUND_SIGMAS * slide.mm_per_turn_sigma / abs(slide.mm_per_turn),
            }
        play = {"backlash_deg": aim.backlash_deg + BOUND_SIGMAS * aim.backlash_sigma_deg}
        return self.replace_in_tables(slide=changes, aim=play)

    def with_place(self, found: PlaceCalibration) -> Self:
        """The finger where it was found to stand, with the zero that belongs to that."""
        zero_sigma_mm = max(found.covariance[4][4], 0.0) ** 0.5
        slide = {
            "zero_mm": found.zero_mm,
            "zero_bound_mm": BOUND_SIGMAS * zero_sigma_mm,
            "mm_per_turn": found.mm_per_turn,
        }
        return self.place_in_hand_frame(found, slide=slide)

    def with_bounds(self, found: ContactBounds) -> Self:
        """The finger with contact bounds, which contain those of zero and travel, too."""
        known = super().with_bounds(found)
        return known.replace_in_tables(slide={"zero_bound_mm": 0.0, "mm_per_turn_spread": 0.0})
