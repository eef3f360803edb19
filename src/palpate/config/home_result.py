"""Result of `palpate home`: `palpate/home@1`."""

from typing import Literal

from palpate.config.results import Out

__all__ = ["HomeOut", "HomedSlideOut"]


class HomedSlideOut(Out):
    """A slide whose turn is known now: servo `dxl_id` counts `turns` ahead of the rig file's angles."""

    finger: str
    dxl_id: int
    turns: int


class HomeOut(Out):
    """Slides that were homed, in the order of the rig file's fingers."""

    format: Literal["palpate/home@1"] = "palpate/home@1"
    slides: tuple[HomedSlideOut, ...]
