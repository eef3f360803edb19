"""Magnetometer skins as a plug-in: ReSkin and AnySkin boards (`reskin`), wrapped round a tip.

Everything that only these need is in this package: codec, host driver, emulated skin and the keys of a rig
file. `pyproject.toml` registers `RESKIN` as an entry point.
"""

from collections.abc import Callable
from typing import Annotated

import numpy as np
from pydantic import Field

from palpate.plugins import (
    ArrayPlugin,
    Clock,
    Description,
    EmulatedFreeRunningArray,
    Floats,
    Port,
    Taxels,
    WrappedArrayConfig,
    first_corner,
    wrapped_description,
)
from palpate_reskin.driver import COUNTS_PER_UT, ReskinArray
from palpate_reskin.emulated import MagneticSkin, SkinTruth

__all__ = ["RESKIN", "MagneticSkin", "ReskinArray", "ReskinConfig", "SkinTruth"]

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class ReskinConfig(WrappedArrayConfig):
    """Keys of a magnetometer skin in a rig file."""

    microtesla_per_n: Positive = Field(
        description="Sum of |ΔB| of all magnetometers by which 1 N on the skin shows; gain_spread bounds how "
        "far it is off anywhere on the skin (reskin)."
    )
    depth_mm: Positive = Field(
        default=3.5, description="Depth of the magnetometers below the skin's surface (emulated reskin only)."
    )


def _description(config: ReskinConfig, tip_radius_mm: float, emulated: bool) -> Description:
    return wrapped_description(
        config,
        tip_radius_mm,
        "reskin",
        counts_per_n=COUNTS_PER_UT * config.microtesla_per_n,
        bit_depth=16,
        emulated=emulated,
    )


def _driver(port: Port, clock: Clock, finger: str, config: ReskinConfig, tip_radius_mm: float) -> ReskinArray:
    emulated = str(port.port).startswith("mock://")
    return ReskinArray(
        port,
        clock,
        finger,
        _description(config, tip_radius_mm, emulated),
        first_corner(config),
        config.delay_s,
    )


def _emulated(
    taxels: Taxels, advance: Callable[[float], None], config: ReskinConfig, tip_radius_mm: float
) -> EmulatedFreeRunningArray:
    cells, described = taxels.description, _description(config, tip_radius_mm, True)
    at = described.positions_mm() - config.depth_mm * described.normals()
    skin = MagneticSkin(cells, _in_order(at, config), SkinTruth(config.depth_mm), _seed(cells))
    return EmulatedFreeRunningArray(cells, advance, config.rate_hz, skin.frame)


def _in_order(places_mm: Floats, config: ReskinConfig) -> Floats:
    """Places (n, 3) as the board counts its magnetometers."""
    corner = first_corner(config)
    each = [corner.flip(np.ascontiguousarray(places_mm[..., axis])).ravel() for axis in range(3)]
    return np.stack(each, axis=1)


def _seed(cells: Description) -> int:
    """A seed of its own for each emulated skin."""
    return int.from_bytes(cells.unique_id, "little")


RESKIN = ArrayPlugin(ReskinConfig, _driver, _emulated)
"""Entry point `reskin`."""
