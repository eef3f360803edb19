"""Tables `[emulation.bus_adapter]` and `[emulation.array_adapter]` of a rig file: emulated USB adapters."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from palpate.config.fields import FileModel, Flag, Length, Positive, in_order

__all__ = ["AdapterConfig", "Span"]

Span = Annotated[tuple[Length, Length], AfterValidator(in_order)]
"""[lo, hi], from which the seed draws."""


class AdapterConfig(FileModel):
    """What USB adapters do to the bytes that pass, and when they go away. Ranges are drawn by the seed."""

    latency_ms: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1, le=255)] = Field(
        default=1.0,
        description="Latency timer: what does not fill a packet of 62 bytes waits so long at most.",
    )
    echoes: Flag = Field(default=False, description="Whether it returns whatever is sent.")
    stall_ms: Span | None = Field(
        default=None, description="[lo, hi]: a hub passes nothing for so long, now and then."
    )
    stall_every_s: Positive = Field(default=2.0, description="Time between such stalls, on average.")
    gone_after_s: Span | None = Field(
        default=None,
        description="[lo, hi]: so long after the start it is unplugged, of arrays' one; absent: never.",
    )
    gone_for_s: Positive = Field(default=2.0, description="And comes back so much later.")
    comes_back_as: Literal["same", "other"] = Field(
        default="same", description="Under the name that it had, or another one."
    )
    grabbed_s: Length = Field(
        default=0.0,
        description="For so long after it is first opened, another program writes and reads, too.",
    )
