"""Resistive matrices, wrapped round a tip and read by an Arduino, as a plug-in (`fsr-matrix`).

`pyproject.toml` registers `FSR_MATRIX` as an entry point. Cells of such a matrix are not linear and remember,
so that the shapes of contacts that other arrays are compared with mean nothing: the matrix is described as a
free surface, of which normals are taken from the places that are pressed.
"""

from collections.abc import Callable

from palpate.plugins import (
    ArrayPlugin,
    Clock,
    EmulatedFreeRunningArray,
    FreeRunningArray,
    InputError,
    Port,
    Taxels,
    wrapped_description,
)
from palpate_fsr_matrix.circuit import COUNTS_PER_REFERENCE
from palpate_fsr_matrix.config import FsrMatrixConfig, first_of
from palpate_fsr_matrix.driver import fsr_matrix
from palpate_fsr_matrix.emulated import FsrTruth, ResistiveSkin

__all__ = ["FSR_MATRIX", "FsrMatrixConfig", "FsrTruth", "ResistiveSkin"]


def _driver(
    port: Port, clock: Clock, finger: str, config: FsrMatrixConfig, tip_radius_mm: float
) -> FreeRunningArray:
    description = wrapped_description(
        config,
        tip_radius_mm,
        "fsr-matrix",
        counts_per_n=COUNTS_PER_REFERENCE * config.conductance_per_n,
        bit_depth=16,
        emulated=str(port.port).startswith("mock://"),
    )
    return fsr_matrix(port, clock, finger, description, config)


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
    seed = int.from_bytes(cells.unique_id, "little")
    skin = ResistiveSkin(cells, first_of(config), FsrTruth(), seed, config.matrix)
    return EmulatedFreeRunningArray(cells, advance, config.rate_hz, skin.frame)


FSR_MATRIX = ArrayPlugin(FsrMatrixConfig, _driver, _emulated)
"""Entry point `fsr-matrix`."""
