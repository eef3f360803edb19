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
    Port,
    Taxels,
    check_cells,
    first_corner,
    wrapped_description,
)
from palpate_fsr_matrix.circuit import COUNTS_PER_REFERENCE
from palpate_fsr_matrix.config import FsrMatrixConfig
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
    check_cells(config, cells)
    seed = int.from_bytes(cells.unique_id, "little")
    skin = ResistiveSkin(cells, first_corner(config), FsrTruth(), seed, config.matrix)
    return EmulatedFreeRunningArray(cells, advance, config.rate_hz, skin.frame)


FSR_MATRIX = ArrayPlugin(FsrMatrixConfig, _driver, _emulated)
"""Entry point `fsr-matrix`."""
