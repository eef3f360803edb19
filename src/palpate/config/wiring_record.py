"""Confirmed wiring, `palpate/confirmed@1`: beside the rig file, what was proven of which devices.

`check --press --move` writes it where a person saw that all is as the rig file says, and `calibrate`, which
moves and feels with every finger. Ports are not in it: an array is known by its unique id wherever it is
plugged in. Adapters are not either, as any will do.
"""

import math
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Literal, Self

from pydantic import Field

from palpate.config.fields import Count, FileModel, Items, Name, Number, Point, Text, UtcTime
from palpate.config.loading import Source, load_toml
from palpate.config.rig_file import RigFile
from palpate.config.rig_fingers import FingerConfig

_SAME_PLACE_MM, _SAME_DIRECTION_DEG = 20.0, 15.0
"""How far places and directions may be corrected since: wiring that is wrong is wrong by more."""


class ConfirmedFinger(FileModel):
    """A finger as it was when its wiring was proven; keys as in the rig file."""

    name: Name = Field(description="Which finger.")
    base_mm: Point = Field(description="Where it stands.")
    heading_deg: Number = Field(description="Its direction.")
    servos: Items[tuple[Count, Text, Number]] = Field(
        description="Of each servo its id, its model, and what a turn of it does (gear_ratio, mm_per_turn)."
    )
    array: Text = Field(description="Unique id of its array, in hexadecimal.")
    array_heading_deg: Number = Field(description="Where the array's middle looks.")
    first_texel: Text = Field(description="Where the array begins to count.")

    @classmethod
    def of(cls, spec: FingerConfig, array: str) -> Self:
        """A finger of the rig file with the unique id of its array."""
        joints = spec.servos.values()
        return cls(
            name=spec.name,
            base_mm=spec.base_mm,
            heading_deg=spec.heading_deg,
            servos=[(item.dxl_id, item.model, item.ratio) for item in joints],
            array=array,
            array_heading_deg=spec.array.heading_deg,
            first_texel=spec.array.first_texel or "lower-left",
        )

    def difference(self, now: "ConfirmedFinger") -> str | None:
        """Say what is not as it was; None if all is."""
        if self.array != now.array:
            return f"its array is another, {now.array}"
        before, after = ([(*a, math.copysign(1, b)) for *a, b in item.servos] for item in (self, now))
        if before != after:
            return "its servos have other ids, models or directions"
        turned = (self.heading_deg - now.heading_deg, self.array_heading_deg - now.array_heading_deg)
        far = any(abs(math.remainder(angle, 360)) > _SAME_DIRECTION_DEG for angle in turned)
        if (
            far
            or math.dist(self.base_mm, now.base_mm) > _SAME_PLACE_MM
            or self.first_texel != now.first_texel
        ):
            return "it stands elsewhere, or its array is mounted in another way"
        return None


class ConfirmedWiring(FileModel):
    """Wiring of a rig that was proven, `palpate/confirmed@1`."""

    format: Literal["palpate/confirmed@1"]
    rig: Name = Field(description="Name of the rig.")
    made: UtcTime = Field(description="When it was proven, in UTC.")
    by: Literal["check", "calibrate"] = Field(description="Command that did it.")
    fingers: Items[ConfirmedFinger] = Field(min_length=1, description="The rig's fingers, in its order.")

    @classmethod
    def of(
        cls, rig: RigFile, arrays: Mapping[str, str], made: datetime, by: Literal["check", "calibrate"]
    ) -> Self:
        """Wiring of a rig as its file has it; `arrays`: unique ids by finger, of all of them."""
        fingers = [ConfirmedFinger.of(spec, arrays[spec.name]) for spec in rig.fingers]
        return cls(format="palpate/confirmed@1", rig=rig.name, made=made, by=by, fingers=fingers)

    def difference(self, rig: RigFile, arrays: Mapping[str, str]) -> str | None:
        """Say what has changed since; None if nothing has."""
        if [item.name for item in self.fingers] != [item.name for item in rig.fingers]:
            return "the rig has other fingers"
        for item, spec in zip(self.fingers, rig.fingers, strict=True):
            found = item.difference(ConfirmedFinger.of(spec, arrays[spec.name]))
            if found is not None:
                return f"finger {item.name}: {found}"
        return None


def proof_path(rig: Path) -> Path:
    """Path of a rig file's confirmed wiring, beside it: `bench.toml` → `bench.confirmed.toml`."""
    return rig.with_name(f"{rig.stem}.confirmed.toml")


def load_confirmed(source: Source) -> ConfirmedWiring:
    """Read confirmed wiring. Raises InputError, one line."""
    return load_toml(source, ConfirmedWiring, {})
