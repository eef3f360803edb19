"""Keys of a resistive matrix in a rig file."""

from typing import Annotated

from pydantic import Field

from palpate.plugins import WrappedArrayConfig

__all__ = ["FsrMatrixConfig"]


class FsrMatrixConfig(WrappedArrayConfig):
    """Keys of a resistive matrix in a rig file."""

    conductance_per_n: Annotated[float, Field(gt=0, allow_inf_nan=False)] = Field(
        description="Conductance of a cell by 1 N, over that of its column's resistor; gain_spread bounds "
        "how far it is off in any cell, at any force, whether force grows or falls (fsr-matrix)."
    )
    matrix: Annotated[int, Field(strict=True, ge=0, le=7)] = Field(
        default=0, description="Which of the board's matrices is on this tip (fsr-matrix)."
    )
    matrices: Annotated[int, Field(strict=True, ge=1, le=8)] = Field(
        default=1, description="How many matrices the board has (fsr-matrix)."
    )
