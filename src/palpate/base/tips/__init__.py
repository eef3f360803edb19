"""Tips: the shapes that a fingertip may have, each with a module of its own.

A new shape is a module here and a member below; code that works with fingers uses its attributes (`tip`).
Layers with their own geometry for it (the recogniser's obstacles and the emulator's outlines, which check
each other) have tables by shape.
"""

from collections.abc import Mapping
from enum import StrEnum
from functools import cache
from typing import Any, TypeVar

from palpate.base.tips.ball import Ball
from palpate.base.tips.cylinder import Cylinder
from palpate.base.tips.pad import Pad
from palpate.base.tips.tip import Ability, Refusals, Tip

__all__ = ["Ability", "Refusals", "Tip", "TipShape", "implementation_for", "tip_of"]

T = TypeVar("T")


class TipShape(StrEnum):
    """Shape of a fingertip: an upright cylinder, a ball or a flat pad (docs/recogniser.md)."""

    tip: Tip

    CYLINDER = Cylinder()
    BALL = Ball()
    PAD = Pad()

    def __new__(cls, tip: Any) -> "TipShape":
        """Shape as files write it, which has the tip's facts beside it."""
        member = str.__new__(cls, tip.shape)
        member._value_, member.tip = tip.shape, tip
        return member


@cache
def tip_of(shape: str = "cylinder") -> Tip:
    """Facts of tips of a shape."""
    return TipShape(shape).tip


def implementation_for(shape: str, table: Mapping[TipShape, T], what: str) -> T:
    """Entry of a layer's table for tips of a shape; InputError that `what` is not known if it has none."""
    if shape not in table:
        raise tip_of(shape).not_yet(what)
    return table[TipShape(shape)]
