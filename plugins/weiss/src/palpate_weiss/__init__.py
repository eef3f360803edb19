"""Weiss Robotics' tactile sensors as plug-ins: WTS modules (`weiss-wts`) and the DSA (`weiss-dsa`).

Everything that only these devices need is in this package: codec, host drivers, emulated devices and the keys
of a rig file. `pyproject.toml` registers `WTS` and `DSA` as entry points, as another distribution would.
"""

from collections.abc import Callable
from typing import Annotated

from pydantic import Field

from palpate.plugins import (
    ArrayPlugin,
    Clock,
    Description,
    MountedArrayConfig,
    Port,
    Taxels,
    mounting_of,
)
from palpate_weiss.arrays import DsaArray, WtsArray
from palpate_weiss.emulated_arrays import EmulatedDsa, EmulatedWts
from palpate_weiss.messages import MatrixInfo

__all__ = ["DSA", "WTS", "DsaConfig", "WtsConfig"]

_DSA_MATRICES = 2


class WtsConfig(MountedArrayConfig):
    """Keys of a WTS module in a rig file."""


class DsaConfig(MountedArrayConfig):
    """Keys of a DSACON32 controller in a rig file."""

    matrix: Annotated[int, Field(strict=True, ge=0, le=255)] | None = Field(
        default=None,
        description="Which of the controller's matrices is on this tip, 0 if left out (weiss-dsa).",
    )


def _matrix(description: Description, config: MountedArrayConfig, tip_radius_mm: float) -> MatrixInfo:
    """The matrix as the device describes it: its own columns and rows, sizes in whole 1/100 mm."""
    cells = (description.cols, description.rows)
    (first_rad, second_rad), (low_mm, high_mm) = description.columns[:2], description.row_heights_mm[:2]
    texel_mm = (round((second_rad - first_rad) * tip_radius_mm, 2), round(high_mm - low_mm, 2))
    if mounting_of(config, tip_radius_mm).upright:
        cells, texel_mm = cells[::-1], texel_mm[::-1]
    return MatrixInfo(*cells, *texel_mm, description.max_count)


def _wts_driver(port: Port, clock: Clock, finger: str, config: WtsConfig, tip_radius_mm: float) -> WtsArray:
    return WtsArray(port, clock, finger, mounting_of(config, tip_radius_mm))


def _emulated_wts(
    taxels: Taxels, advance: Callable[[float], None], config: WtsConfig, tip_radius_mm: float
) -> EmulatedWts:
    return EmulatedWts(
        taxels,
        _matrix(taxels.description, config, tip_radius_mm),
        advance,
        baudrate=config.baudrate_bps,
        to_device=mounting_of(config, tip_radius_mm).to_device,
    )


def _dsa_driver(port: Port, clock: Clock, finger: str, config: DsaConfig, tip_radius_mm: float) -> DsaArray:
    return DsaArray(port, clock, finger, mounting_of(config, tip_radius_mm), config.matrix or 0)


def _emulated_dsa(
    taxels: Taxels, advance: Callable[[float], None], config: DsaConfig, tip_radius_mm: float
) -> EmulatedDsa:
    touched = config.matrix or 0
    return EmulatedDsa(
        taxels,
        [_matrix(taxels.description, config, tip_radius_mm)] * max(_DSA_MATRICES, touched + 1),
        advance,
        touched=touched,
        baudrate=config.baudrate_bps,
        to_device=mounting_of(config, tip_radius_mm).to_device,
    )


WTS = ArrayPlugin(WtsConfig, _wts_driver, _emulated_wts)
"""Entry point `weiss-wts`."""

DSA = ArrayPlugin(DsaConfig, _dsa_driver, _emulated_dsa)
"""Entry point `weiss-dsa`."""
