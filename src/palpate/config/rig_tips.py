"""Tip tables of a rig file: the cylinder, ball or pad at a finger's end, in mm and N."""

import math
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from palpate.base.tips import Tip, TipShape
from palpate.config.fields import FileModel, Length, Positive
from palpate.config.problems import problem
from palpate.config.rig_servos import Share


def _radius_of_width(data: dict[str, Any]) -> float:
    """Radius that a tip's width stands for if a file does not give it; 0 for shapes whose files must."""
    shape, width_mm = data.get("shape"), data.get("width_mm")
    made = shape.tip.radius_of_width_mm(width_mm) if isinstance(shape, TipShape) and width_mm else None
    return made or 0.0


def check_keys(tip: Tip, table: FileModel, group: str = "") -> None:
    """Refuse a table without a key that tips of this shape need, or with one that they lack.

    `group`: of the finger's table, "" for the tip's own. Raises a pydantic error.
    """
    place = [group] if group else []
    for path, why in {**tip.lacks, **tip.needs}.items():
        of, _, key = path.rpartition(".")
        if of != group:
            continue
        value, is_needed = getattr(table, key), path in tip.needs
        is_given = bool(value) and value != type(table).model_fields[key].default
        if is_needed != is_given:
            raise problem(why, *place, *([] if is_needed else [key]))


class TipConfig(FileModel):
    """The fingertip: an upright cylinder, a ball, or a flat pad."""

    shape: TipShape = Field(
        default=TipShape.CYLINDER,
        description="Shape of what touches: an upright cylinder, a ball with its equator at height_mm, or a "
        "pad: an upright flat face across the slide, its middle where the tip is.",
    )
    width_mm: Annotated[Positive, Field(ge=0.2, le=200)] | None = Field(
        default=None, description="Width of a pad's face, from edge to edge."
    )
    radius_mm: Annotated[Positive, Field(ge=0.1, le=100)] = Field(
        default_factory=_radius_of_width,
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
    bears_n: Positive | None = Field(
        default=None,
        description="Force that tip and array bear: a finger that nobody stops must not press harder.",
    )
    max_friction: Annotated[Length, Field(le=2)] = Field(
        default=0.0,
        description="Bound: the coefficient of friction between the tip and what it touches is at most this.",
    )

    @model_validator(mode="after")
    def _fits_its_shape(self) -> Self:
        check_keys(self.kind, self)
        stands_for = self.width_mm and self.kind.radius_of_width_mm(self.width_mm)
        if stands_for is not None and self.radius_mm != stands_for:
            raise problem(
                f"is {self.radius_mm:g}, not half of width_mm ({self.width_mm:g}); leave it out: a "
                f"{self.shape} has width_mm alone",
                "radius_mm",
            )
        share, text = self.kind.max_bound_share, f"{self.kind.radius_words} ({self.radius_mm:g})"
        if self.radius_bound_mm >= self.radius_mm:
            raise problem(f"is {self.radius_bound_mm:g}, not below {text}", "radius_bound_mm")
        if self.radius_bound_mm > share * self.radius_mm:
            why = f"is {self.radius_bound_mm:g}; that of a {self.shape} is at most {share:g} of {text}"
            raise problem(why, "radius_bound_mm")
        return self

    @property
    def kind(self) -> Tip:
        """Facts of tips of its shape."""
        return self.shape.tip

    @property
    def least_share(self) -> float:
        """Radius of the least circle that touches parts, as a share of the tip's: the cosine of its latitude.

        A force on the skin there has at least this share aside, and a dent is that share of the way in.
        """
        latitude = self.max_latitude_deg
        return self.kind.least_share if latitude is None else math.cos(math.radians(latitude))

    @property
    def half_width_mm(self) -> float:
        """Distance from the tip's middle to what of it is furthest to the side of its travel."""
        return self.kind.half_width_mm(self.radius_mm, self.width_mm)

    @property
    def size_text(self) -> str:
        """Size of the tip, to follow its noun."""
        return self.kind.size_text(self.radius_mm, self.width_mm)

    @property
    def half_length_mm(self) -> float:
        """Distance from a cylinder's middle to either end; 0 for one that is as thin as a disc."""
        return (self.length_mm or 0.0) / 2

    @property
    def half_height_mm(self) -> float:
        """Distance from the tip's middle to its highest and lowest point."""
        return self.kind.half_height_mm(self.radius_mm, self.half_length_mm)
