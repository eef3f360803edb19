"""Table `[emulation.mechanics]` of a rig file: mechanics as bought and screwed together."""

from typing import Annotated

from pydantic import AfterValidator, Field

from palpate.config.emulated_adapter import Span
from palpate.config.fields import FileModel, Length, Number, in_order

__all__ = ["MechanicsConfig"]

_Signed = Annotated[tuple[Number, Number], AfterValidator(in_order)]
_Loss = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0, le=0.9)]


class MechanicsConfig(FileModel):
    """Ranges [lo, hi] from which the seed draws; absent: as in the model of the servo and the rig file."""

    friction: Span | None = Field(
        default=None, description="Friction in motion, times that of the servo's model; each servo's own."
    )
    rest_friction: Span | None = Field(
        default=None, description="Friction at rest, times that in motion; at least 1 is taken."
    )
    cogging: Span | None = Field(
        default=None, description="Torque that comes and goes along a turn, times the model's friction."
    )
    torque_loss: Annotated[tuple[_Loss, _Loss], AfterValidator(in_order)] | None = Field(
        default=None, description="Share by which warm motors have less torque for a current."
    )
    supply_ohm: Span | None = Field(
        default=None, description="Resistance of supply and cables that all servos share."
    )
    cable_n: _Signed | None = Field(
        default=None, description="A cable pulls each slide outwards with so many N, inwards if negative."
    )
    slide_deflection_mm_per_n: Annotated[tuple[Length, Length], AfterValidator(in_order)] | None = Field(
        default=None, description="Slides give way along their travel, by so much for each N on the tip."
    )
    slip_mm: _Signed | None = Field(
        default=None, description="The screw of one slide's horn slips once: the tip is off by so much then."
    )
    slip_after_s: Span = Field(default=(5.0, 20.0), description="When it slips, from the start.")
