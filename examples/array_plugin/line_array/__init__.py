"""Plug-in for palpate: an invented tactile array that speaks lines of text, as README.md describes them."""

from typing import Literal

from pydantic import Field

from line_array.driver import LineArray
from line_array.emulated import EmulatedLineArray
from palpate.plugins import ArrayPlugin, MountedArrayConfig, mounting_of

__all__ = ["LINES", "LinesConfig"]


class LinesConfig(MountedArrayConfig):
    """Keys of a line array in a rig file."""

    oversampling: Literal[1, 2, 4, 8] = Field(default=1, description="Samples that make a frame.")


LINES = ArrayPlugin(
    config=LinesConfig,
    driver=lambda port, clock, finger, config, tip_radius_mm: LineArray(
        port, clock, finger, mounting_of(config, tip_radius_mm), config.oversampling
    ),
    emulated=lambda taxels, advance, config, tip_radius_mm: EmulatedLineArray(
        taxels, advance, mounting_of(config, tip_radius_mm)
    ),
)
"""What the entry point `lines` names."""
