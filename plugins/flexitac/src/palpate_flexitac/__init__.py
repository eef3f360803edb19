"""FlexiTac pressure matrices, wrapped round a tip, as a plug-in (`flexitac`).

`pyproject.toml` registers `FLEXITAC` as an entry point. Their taxels are not linear, so that the matrix is
described as a free surface, of which normals are taken from the places that are pressed.
"""

from collections.abc import Callable

import numpy as np
from pydantic import Field

from palpate.plugins import (
    ArrayPlugin,
    Clock,
    DecodedFrame,
    EmulatedFreeRunningArray,
    FreeRunningArray,
    Port,
    Taxels,
    WrappedArrayConfig,
    check_cells,
    first_corner,
    wrapped_description,
)
from palpate_flexitac.codec import MARK, MatrixDecoder
from palpate_flexitac.emulated import FlexiTacTruth, PressedMatrix

__all__ = ["FLEXITAC", "FlexiTacConfig", "FlexiTacTruth", "PressedMatrix"]


class FlexiTacConfig(WrappedArrayConfig):
    """Keys of a FlexiTac matrix in a rig file."""

    counts_per_n: float = Field(
        gt=0,
        allow_inf_nan=False,
        description="What 1 N on a taxel adds to its count; gain_spread bounds how far it is off in any, "
        "at any force, whether force grows or falls (flexitac).",
    )


class _OnTip:
    """Decoder of matrices as they are on the tip."""

    def __init__(self, config: FlexiTacConfig) -> None:
        self._decoder = MatrixDecoder(len(config.row_heights_mm), config.columns)
        self._first = first_corner(config)
        self.faults = self._decoder.faults

    def feed(self, data: bytes) -> list[DecodedFrame]:
        """Take bytes as they came; return the frames that they complete."""
        found = self._decoder.feed(data)
        return [DecodedFrame(self._first.flip(each.astype(np.uint16))) for each in found]


def _driver(
    port: Port, clock: Clock, finger: str, config: FlexiTacConfig, tip_radius_mm: float
) -> FreeRunningArray:
    description = wrapped_description(
        config,
        tip_radius_mm,
        "flexitac",
        counts_per_n=config.counts_per_n,
        bit_depth=8,
        emulated=str(port.port).startswith("mock://"),
    )
    frame_bytes = len(MARK) + description.taxels
    return FreeRunningArray(port, clock, finger, description, _OnTip(config), frame_bytes, config.delay_s)


def _emulated(
    taxels: Taxels, advance: Callable[[float], None], config: FlexiTacConfig, _tip_radius_mm: float
) -> EmulatedFreeRunningArray:
    cells = taxels.description
    check_cells(config, cells)
    seed = int.from_bytes(cells.unique_id, "little")
    skin = PressedMatrix(cells, first_corner(config), FlexiTacTruth(), seed)
    return EmulatedFreeRunningArray(cells, advance, config.rate_hz, skin.frame)


FLEXITAC = ArrayPlugin(FlexiTacConfig, _driver, _emulated)
"""Entry point `flexitac`."""
