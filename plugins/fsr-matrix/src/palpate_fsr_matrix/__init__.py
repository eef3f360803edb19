"""Resistive matrices, wrapped round a tip and read by an Arduino, as a plug-in (`fsr-matrix`).

`pyproject.toml` registers `FSR_MATRIX` as an entry point. Cells of such a matrix are not linear and remember,
so that the shapes of contacts that other arrays are compared with mean nothing: the matrix is described as a
free surface, of which normals are taken from the places that are pressed.
"""

from collections.abc import Callable
from typing import Annotated

from pydantic import Field

from palpate.plugins import (
    ArrayPlugin,
    Clock,
    Corner,
    EmulatedFreeRunningArray,
    InputError,
    Port,
    Taxels,
    WrappedArrayConfig,
    wrapped_description,
)
from palpate_fsr_matrix.circuit import COUNTS_PER_REFERENCE
from palpate_fsr_matrix.driver import FsrMatrix
from palpate_fsr_matrix.emulated import FsrTruth, ResistiveSkin

__all__ = ["FSR_MATRIX", "FsrMatrix", "FsrMatrixConfig", "FsrTruth", "ResistiveSkin"]

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class FsrMatrixConfig(WrappedArrayConfig):
    """Keys of a resistive matrix in a rig file."""

    conductance_per_n: Positive = Field(
        description="Conductance of a cell by 1 N, over that of its column's resistor; gain_spread bounds "
        "how far it is off in any cell, at any force, whether force grows or falls (fsr-matrix)."
    )


def _driver(
    port: Port, clock: Clock, finger: str, config: FsrMatrixConfig, tip_radius_mm: float
) -> FsrMatrix:
    description = wrapped_description(
        config,
        tip_radius_mm,
        "fsr-matrix",
        counts_per_n=COUNTS_PER_REFERENCE * config.conductance_per_n,
        bit_depth=16,
        emulated=str(port.port).startswith("mock://"),
    )
    return FsrMatrix(port, clock, finger, description, _first(config), config.delay_s)


def _emulated(
    taxels: Taxels, advance: Callable[[float], None], config: FsrMatrixConfig, _tip_radius_mm: float
) -> EmulatedFreeRunningArray:
    cells = taxels.description
    rows = len(config.row_heights_mm)
    if (cells.rows, cells.cols) != (rows, config.columns):
        raise InputError(
            f"emulated arrays have {cells.rows} rows and {cells.cols} columns, and the rig file says "
            f"{rows} and {config.columns}"
        )
    skin = ResistiveSkin(cells, _first(config), FsrTruth(), int.from_bytes(cells.unique_id, "little"))
    return EmulatedFreeRunningArray(cells, advance, config.rate_hz, skin.frame)


def _first(config: FsrMatrixConfig) -> Corner:
    return Corner(config.first_texel or "lower-left")


FSR_MATRIX = ArrayPlugin(FsrMatrixConfig, _driver, _emulated)
"""Entry point `fsr-matrix`."""
