"""Tip tables of a rig file: the cylinder, ball or pad at a finger's end, in mm and N."""

import math
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from palpate.base.vocabulary import LEAST_BALL_SHARE
from palpate.config.fields import FileModel, Length, Positive
from palpate.config.problems import problem
from palpate.config.rig_servos import Share

_MAX_BALL_BOUND_SHARE = 0.1


def _half_of_width(data: dict[str, Any]) -> float:
    """Radius of a pad if a file does not give it; others must."""
    return (data.get("width_mm") or 0.0) / 2


class TipConfig(FileModel):
    """The fingertip: an upright cylinder, a ball, or a flat pad."""

    shape: Literal["cylinder", "ball", "pad"] = Field(
        default="cylinder",
        description="Shape of what touches: an upright cylinder, a ball with its equator at height_mm, or a "
        "pad: an upright flat face across the slide, its middle where the tip is.",
    )
    width_mm: Annotated[Positive, Field(le=200)] | None = Field(
        default=None, description="Width of a pad's face, from edge to edge."
    )
    radius_mm: Annotated[Positive, Field(le=100)] = Field(
        default_factory=_half_of_width,
        description="Radius of the cylinder or the ball; of a pad half of its width, and best left out.",
    )
    radius_bound_mm: Length = Field(
        default=0.0,
        description="Bound: the radius is off by at most this; each edge of a pad is no further off.",
    )
    length_mm: Positive | None = Field(
        default=None,
        description="Length of the cylinder's straight part, or height of the pad, its middle at height_mm: "
        "the tip meets the sections all along it. Left out: the one at height_mm only, as for parts with "
        "upright walls there.",
    )
    max_latitude_deg: Annotated[Length, Field(le=60)] | None = Field(
        default=None,
        description="Bound: a ball touches parts no further from its equator than this; left out, 60. Parts "
        "that it may touch elsewhere are refused.",
    )
    stiffness_n_per_mm: Positive = Field(description="Force per mm of dent.")
    stiffness_spread: Share = Field(description="Bound: the stiffness is off by at most this share.")
    max_friction: Annotated[Length, Field(le=2)] = Field(
        default=0.0,
        description="Bound: the coefficient of friction between the tip and what it touches is at most this.",
    )

    @model_validator(mode="after")
    def _is_there(self) -> Self:
        if self.is_pad != (self.width_mm is not None):
            if self.is_pad:
                raise problem('the key "width_mm" is missing: a pad has that in place of radius_mm')
            raise problem(f'is for shape = "pad"; a {self.shape} has radius_mm', "width_mm")
        if self.radius_mm == 0:
            raise problem('the key "radius_mm" is missing')
        if self.is_pad and self.radius_mm != _half_of_width({"width_mm": self.width_mm}):
            raise problem(
                f"is {self.radius_mm:g}, not half of width_mm ({self.width_mm:g}); leave it out: pads have "
                "width_mm alone",
                "radius_mm",
            )
        if self.is_pad and self.max_friction:
            raise problem("must be 0 for pads: what friction does to their skin is not known", "max_friction")
        if self.radius_bound_mm >= self.radius_mm:
            of = "half of width_mm" if self.is_pad else "radius_mm"
            raise problem(
                f"is {self.radius_bound_mm:g}, not below {of} ({self.radius_mm:g})", "radius_bound_mm"
            )
        if self.is_ball and self.length_mm is not None:
            raise problem("is for cylinders; a ball has a radius only", "length_mm")
        if not self.is_ball and self.max_latitude_deg is not None:
            raise problem("is for balls; others touch at their own radius or width", "max_latitude_deg")
        if self.is_ball and self.radius_bound_mm > _MAX_BALL_BOUND_SHARE * self.radius_mm:
            raise problem(
                f"is {self.radius_bound_mm:g}; that of a ball is at most a tenth of radius_mm "
                f"({self.radius_mm:g}): beside its equator errors of the radius count more",
                "radius_bound_mm",
            )
        return self

    @property
    def is_ball(self) -> bool:
        """True if it is a ball."""
        return self.shape == "ball"

    @property
    def is_pad(self) -> bool:
        """True if it is a flat pad."""
        return self.shape == "pad"

    @property
    def least_share(self) -> float:
        """Radius of the least circle that touches parts, as a share of the tip's: the cosine of its latitude.

        A force on the skin there has at least this share aside, and a dent is that share of the way in.
        """
        if not self.is_ball:
            return 1.0
        latitude = self.max_latitude_deg
        return LEAST_BALL_SHARE if latitude is None else math.cos(math.radians(latitude))

    @property
    def half_length_mm(self) -> float:
        """Distance from a cylinder's middle to either end; 0 for one that is as thin as a disc."""
        return (self.length_mm or 0.0) / 2

    @property
    def half_height_mm(self) -> float:
        """Distance from the tip's middle to its highest and lowest point."""
        return self.radius_mm if self.is_ball else self.half_length_mm
