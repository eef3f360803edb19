"""Rig file table of an arm, type "two-link": its keys, its geometry, and its calibration."""

import math
from typing import Literal, Self

from pydantic import Field, model_validator

from palpate.config.calibration_finger import ArmActuatorsCalibration, ArmPlaceCalibration
from palpate.config.fields import FileModel, Length, Positive
from palpate.config.problems import problem
from palpate.config.rig_fingers import BOUND_SIGMAS, FingerConfig
from palpate.config.rig_servos import JointConfig

ARM_MARGIN_MM = 2.0
"""The tip of an arm waits this far outside of the workspace."""


class LinksConfig(FileModel):
    """The two links of an arm, which pass above the parts; the tip hangs down from the end of the second."""

    upper_mm: Positive = Field(description="From the shoulder's axis to the elbow's.")
    fore_mm: Positive = Field(description="From the elbow's axis to the tip's.")
    bound_mm: Length = Field(description="Bound: each length is off by at most this.")
    width_mm: Positive = Field(description="Width of the links, seen from above.")
    links_height_mm: Positive = Field(
        description="Underside of the links above the support plane; parts must be lower."
    )


class ArmFingerConfig(FingerConfig):
    """One finger: an arm of two links, turned by a shoulder servo at the base and an elbow servo."""

    type: Literal["two-link"] = Field(description='"two-link": an arm with a shoulder and an elbow.')
    shoulder: JointConfig
    elbow: JointConfig
    links: LinksConfig

    drawn_within = (
        ("joint_backlash_deg", "shoulder.backlash_deg"),
        ("joint_backlash_deg", "elbow.backlash_deg"),
        ("joint_zero_error_deg", "shoulder.zero_bound_deg"),
        ("joint_zero_error_deg", "elbow.zero_bound_deg"),
        ("link_error_mm", "links.bound_mm"),
    )
    calibrated_by = (ArmActuatorsCalibration, ArmPlaceCalibration)
    no_calibration = "is an arm, which has no aim and no slide"

    @model_validator(mode="after")
    def _bends_one_way(self) -> Self:
        if (why := self.tip.kind.cannot.get("turn on the way")) is not None:
            raise problem(f'is "{self.tip.shape}"; {why}', "tip", "shape")
        lo, hi = self.elbow.range_deg
        if lo <= 0 <= hi or max(abs(lo), abs(hi)) > 180:
            raise problem(
                f"is [{lo:g}, {hi:g}]; the elbow bends one way, so that both are above 0 or both below, "
                "and by 180 at most",
                *("elbow", "range_deg"),
            )
        if self.height_mm >= self.links.links_height_mm:
            raise problem(
                f"is {self.links.links_height_mm:g}, not above the tip's height_mm ({self.height_mm:g})",
                *("links", "links_height_mm"),
            )
        if self.span_mm[1] > self.links.links_height_mm:
            raise problem(
                f"is {self.links.links_height_mm:g}, below the tip's upper end "
                f"({self.span_mm[1]:g}, by its {self.tip.kind.half_height_key})",
                *("links", "links_height_mm"),
            )
        return self

    @property
    def servos(self) -> dict[str, JointConfig]:
        """Both servos by their keys, the one next to the base first."""
        return {"shoulder": self.shoulder, "elbow": self.elbow}

    @property
    def lever_mm(self) -> float:
        """Length of the second link."""
        return self.links.fore_mm

    def start_tip_mm(self, radius_mm: float) -> tuple[float, float]:
        """Tip centre beside the workspace, next to the base."""
        x, y = self.base_mm
        share = (radius_mm + self.tip.radius_mm + ARM_MARGIN_MM) / math.hypot(x, y)
        return share * x, share * y

    def check_place(self, radius_mm: float, *at: str | int) -> None:
        """Refuse an arm with its base in the workspace, or that cannot wait between its base and that."""
        away = math.hypot(*self.base_mm)
        if away <= radius_mm + self.tip.radius_mm:
            raise problem(
                f"is {away:.4g} mm from the origin; the base must stand outside of the workspace, beyond "
                f"{radius_mm + self.tip.radius_mm:g} mm (workspace.radius_mm + tip.radius_mm)",
                *(*at, "base_mm"),
            )
        tip = self.start_tip_mm(radius_mm)
        x, y = tip[0] - self.base_mm[0], tip[1] - self.base_mm[1]
        upper, fore = self.links.upper_mm, self.links.fore_mm
        bend = (x * x + y * y - upper**2 - fore**2) / (2 * upper * fore)
        if abs(bend) > 1:
            raise problem(
                f"cannot put the tip where it waits, at ({tip[0]:.4g}, {tip[1]:.4g}), "
                f"{math.hypot(x, y):.4g} mm from the base",
                *(*at, "links"),
            )
        elbow = math.copysign(math.acos(bend), self.elbow.range_deg[0])
        across = math.atan2(fore * math.sin(elbow), upper + fore * math.cos(elbow))
        shoulder = math.degrees(math.atan2(y, x) - across) - self.heading_deg
        for key, angle, (lo, hi) in (
            ("shoulder", math.remainder(shoulder, 360.0), self.shoulder.range_deg),
            ("elbow", math.degrees(elbow), self.elbow.range_deg),
        ):
            if not lo < angle < hi:
                raise problem(
                    f"is [{lo:g}, {hi:g}]; with the tip where it waits, at ({tip[0]:.4g}, {tip[1]:.4g}), the "
                    f"{key} stands at {angle:.4g}",
                    *(*at, key, "range_deg"),
                )

    def with_actuators(self, found: ArmActuatorsCalibration) -> Self:
        """The arm with the plays of its joints."""
        shoulder, elbow = (
            {"backlash_deg": joint.backlash_deg + BOUND_SIGMAS * joint.backlash_sigma_deg}
            for joint in (found.shoulder, found.elbow)
        )
        return self.replace_in_tables(shoulder=shoulder, elbow=elbow)

    def with_place(self, found: ArmPlaceCalibration) -> Self:
        """The arm where it was found to stand; its shoulder's zero is in its heading."""
        lengths = {"upper_mm": found.upper_mm, "fore_mm": found.fore_mm}
        zero_deg = self.elbow.zero_deg - self.elbow.gear_ratio * found.elbow_zero_deg
        return self.place_in_hand_frame(
            found,
            links=lengths | {"bound_mm": BOUND_SIGMAS * max(found.upper_sigma_mm, found.fore_sigma_mm)},
            shoulder={"zero_bound_deg": 0.0},
            elbow={"zero_deg": zero_deg, "zero_bound_deg": BOUND_SIGMAS * found.elbow_zero_sigma_deg},
        )
