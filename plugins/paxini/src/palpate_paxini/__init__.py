"""Fingertips of PaXini, as ORCA Touch has them, on a communication board as a plug-in (`paxini`).

`pyproject.toml` registers `PAXINI` as an entry point. A fingertip is described as a free surface, with the
places and normals that its maker gives, of which normals are taken from the places that are pressed.
"""

from collections.abc import Callable
from typing import ClassVar, Literal

from pydantic import Field

from palpate.plugins import (
    ArrayPlugin,
    Clock,
    Corner,
    Description,
    FreeRunningArrayConfig,
    Port,
    Shape,
    Taxels,
    first_corner,
)
from palpate_paxini.codec import COUNTS_PER_N, MODULES
from palpate_paxini.driver import PaxiniArray
from palpate_paxini.emulated import EmulatedFingertip, TaxelTruth, ThreeAxisSkin
from palpate_paxini.fingertip import (
    COLUMNS,
    READING_BITS,
    READING_PER_STEP,
    ROWS,
    Fingertip,
    FingertipName,
    fingertip,
)

__all__ = ["PAXINI", "EmulatedFingertip", "PaxiniArray", "PaxiniConfig", "TaxelTruth", "ThreeAxisSkin"]

_READINGS_PER_N = READING_PER_STEP * COUNTS_PER_N


class PaxiniConfig(FreeRunningArrayConfig):
    """Keys of a fingertip on a communication board in a rig file."""

    idle_noise_counts: ClassVar[float] = 0.0  # steps of 0.1 N hide it
    sensor: FingertipName = Field(description="Part number of the fingertip (paxini).")
    module: Literal[MODULES] = Field(  # type: ignore[valid-type]  # a literal of 28 names
        description="Place on the board at which the fingertip is, as index-tip (paxini)."
    )
    first_texel: Literal["lower-left", "upper-right"] | None = Field(
        default=None,
        description="lower-left if the fingertip's round end points up, as if left out; upper-right if it "
        "points down (paxini).",
    )


def _tip(config: PaxiniConfig) -> Fingertip:
    return fingertip(config.sensor, upside_down=first_corner(config) is Corner.UPPER_RIGHT)


def _description(config: PaxiniConfig, tip: Fingertip, emulated: bool) -> Description:
    places = [*zip(tip.place_mm.reshape(-1, 3).tolist(), tip.normal.reshape(-1, 3).tolist(), strict=True)]
    return Description(
        unique_id=f"{config.sensor[5:]}{MODULES.index(config.module):03}".encode().ljust(16, b"\0"),
        firmware=config.sensor,
        emulated=emulated,
        shape=Shape.FREE,
        rows=ROWS,
        cols=COLUMNS,
        bit_depth=READING_BITS,
        max_rate_hz=config.rate_hz,
        full_scale_n=((1 << READING_BITS) - 1) / _READINGS_PER_N,
        counts_per_n=_READINGS_PER_N,
        tip_radius_mm=0.0,
        columns=(),
        row_heights_mm=(),
        geometry=tuple(value for place, normal in places for value in (*place, *normal)),
    )


def _driver(
    port: Port, clock: Clock, finger: str, config: PaxiniConfig, _tip_radius_mm: float
) -> PaxiniArray:
    tip, emulated = _tip(config), str(port.port).startswith("mock://")
    described = _description(config, tip, emulated)
    module = MODULES.index(config.module)
    return PaxiniArray(port, clock, finger, described, tip, module, config.delay_s)


def _emulated(
    taxels: Taxels, advance: Callable[[float], None], config: PaxiniConfig, _tip_radius_mm: float
) -> EmulatedFingertip:
    cells, tip = taxels.description, _tip(config)
    skin = ThreeAxisSkin(cells, tip, TaxelTruth(), int.from_bytes(cells.unique_id, "little"))
    module = MODULES.index(config.module)
    return EmulatedFingertip(module, skin, cells, tip.taxels, advance, config.rate_hz)


PAXINI = ArrayPlugin(PaxiniConfig, _driver, _emulated, EmulatedFingertip.join)
"""Entry point `paxini`."""
