"""Table `[emulation.part]` of a rig file: whether and how an emulated part moves when fingers push it."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag

from palpate.config.fields import FileModel, in_order
from palpate.config.model_places import TAG
from palpate.config.problems import problem

__all__ = ["EmulatedPartConfig", "Friction", "Mass", "Range"]

Mass = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=100)]
"""kg"""

Friction = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=2)]
"""Coefficient of Coulomb friction."""

_FrictionOrNone = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=2)]

Range = tuple[float, float]
"""[lo, hi], from which the seed draws."""


def _kind(value: object) -> str:
    return TAG + ("range" if isinstance(value, list | tuple) else "number")


_MassOrRange = Annotated[
    Annotated[Mass, Tag(TAG + "number")]
    | Annotated[tuple[Mass, Mass], AfterValidator(in_order), Tag(TAG + "range")],
    Discriminator(_kind),
]
_FrictionOrRange = Annotated[
    Annotated[Friction, Tag(TAG + "number")]
    | Annotated[tuple[Friction, Friction], AfterValidator(in_order), Tag(TAG + "range")],
    Discriminator(_kind),
]
_TipFrictionOrRange = Annotated[
    Annotated[_FrictionOrNone, Tag(TAG + "number")]
    | Annotated[tuple[_FrictionOrNone, _FrictionOrNone], AfterValidator(in_order), Tag(TAG + "range")],
    Discriminator(_kind),
]


def _feet_that_stand(count: int) -> int:
    if count in (1, 2):
        raise problem(f"is {count}; a part stands on 3 feet at least, or on its whole base (0)")
    return count


class EmulatedPartConfig(FileModel):
    """What moves the emulated part. A number, or [lo, hi] from which the seed draws."""

    engine: Literal["still", "quasi-static", "mujoco"] = Field(
        description="still: nothing moves it; quasi-static: it slides without inertia; mujoco: a rigid body "
        "in MuJoCo, which needs palpate[physics]."
    )
    mass_kg: _MassOrRange = Field(default=0.15, description="Mass; drawn log-uniformly from a range.")
    friction: _FrictionOrRange = Field(default=0.3, description="Friction between part and table.")
    tip_friction: _TipFrictionOrRange = Field(
        default=0.0, description="Friction between tips and whatever they touch."
    )
    feet: Annotated[int, Field(strict=True, ge=0, le=100), AfterValidator(_feet_that_stand)] = Field(
        default=0,
        description="0: it stands on its whole base; 3 or more: on so many points, drawn by the seed and "
        "unequally loaded.",
    )
