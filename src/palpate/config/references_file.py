"""References for calibration, format `palpate/references@1`: TOML with a disc and a convex plate.

What a person measures with callipers before a rig is calibrated. `docs/calibration.md` says how to choose.
"""

import hashlib
import json
from typing import Literal

from pydantic import Field

from palpate.config.fields import FileModel, Items, Length, Point, Positive
from palpate.config.loading import Source, load_toml

__all__ = ["DiscConfig", "PlateConfig", "ReferencesFile", "load_references", "references_sha256"]


class DiscConfig(FileModel):
    """A round reference."""

    diameter_mm: Positive = Field(description="Diameter.")
    height_mm: Positive = Field(description="Height of its top above the support plane.")
    tolerance_mm: Length = Field(default=0.0, description="Its rim is off by at most this.")


class PlateConfig(FileModel):
    """A convex reference with straight faces, such as a square plate."""

    outline_mm: Items[Point] = Field(min_length=3, description="Corners [x, y] in order round it.")
    height_mm: Positive = Field(description="Height of its top above the support plane.")
    tolerance_mm: Length = Field(default=0.0, description="Its faces are off by at most this.")


class ReferencesFile(FileModel):
    """The things that fingers touch to be calibrated, `palpate/references@1`."""

    format: Literal["palpate/references@1"]
    disc: DiscConfig = Field(description="A disc.")
    plate: PlateConfig = Field(description="A plate.")


def references_sha256(file: ReferencesFile) -> str:
    """SHA-256 of the shapes, by which a calibration knows what it was made with."""
    return hashlib.sha256(json.dumps(file.model_dump(mode="json"), sort_keys=True).encode()).hexdigest()


def load_references(source: Source) -> ReferencesFile:
    """Read and check a references file. Raises InputError, one line."""
    return load_toml(source, ReferencesFile, {})
