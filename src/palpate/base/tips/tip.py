"""Tip: properties of a shape of fingertip that do not depend on the size of an individual tip.

Each shape has its own module in this package. All other code uses these attributes and never tests for a
shape; what a shape does not support yet is refused with a one-line message.
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal, get_args

from palpate.base.errors import InputError

Ability = Literal[
    "calibrate",
    "calibrate taxels",
    "check what parts hold",
    "compare touches",
    "identify",
    "move parts",
    "plan",
    "simulate",
    "turn on the way",
]
"""What a rig may be asked for that tips of some shapes cannot do."""

Refusals = Mapping[Ability, str]
"""Abilities that a tip has not, and why; a reason goes on from "its tip is a ball, and"."""


class Tip:
    """A shape of fingertip; attributes are those of an upright round tip unless the shape says otherwise.

    `shape`: as in files; `noun`: for people. `needs`: keys of a finger's table in the rig file that tips of
    the shape must have; `lacks`: keys that they cannot have; with what is said of them. Keys outside the
    tip's own table are written as "array.pitch_mm".
    """

    shape: str
    noun: str = "tip"
    cannot: ClassVar[Refusals] = dict.fromkeys(get_args(Ability), "palpate does not do that with it yet")
    needs: ClassVar[Mapping[str, str]] = {"radius_mm": 'the key "radius_mm" is missing'}
    lacks: ClassVar[Mapping[str, str]] = {}

    has_face: bool = False
    """True if it touches with a flat face across its travel, half as wide as its radius says."""
    is_upright: bool = True
    """True if its radius is the same at all of its heights."""
    measures_normal: bool = True
    """True if what its array shows says something of the surface's normal."""
    least_share: float = 1.0
    """Radius of the least circle of it that touches parts, as a share of its own."""
    corners_at_once: int = 1
    """Corners of a part that it may meet at once, each with the force of a whole touch."""

    half_height_key: str = "length_mm"
    """Key of the rig file that says how high it is."""
    radius_words: str = "radius_mm"
    max_bound_share: float = 1.0
    """Largest bound that a radius may have, as a share of it."""

    @property
    def with_article(self) -> str:
        """Noun with its article."""
        return f"{'an' if self.noun[0] in 'aeiou' else 'a'} {self.noun}"

    def size_text(self, radius_mm: float, width_mm: float | None = None) -> str:  # noqa: ARG002
        """Size of one, to follow its noun."""
        return f"of radius {radius_mm:g} mm"

    def radius_of_width_mm(self, width_mm: float) -> float | None:  # noqa: ARG002
        """Radius that a width stands for; None if files give the radius itself."""
        return None

    def half_width_mm(self, radius_mm: float, width_mm: float | None) -> float:  # noqa: ARG002
        """Distance from its middle to what of it is furthest to the side of its travel."""
        return radius_mm

    def plan_mm(self, radius_mm: float, width_mm: float | None) -> Sequence[tuple[float, float]]:  # noqa: ARG002
        """Outline seen from above, points ahead and to the left of its middle; empty for a circle."""
        return ()

    def half_height_mm(self, radius_mm: float, half_length_mm: float) -> float:  # noqa: ARG002
        """Distance from its middle to its highest and lowest point."""
        return half_length_mm

    def radius_at_mm(self, radius_mm: float, away_mm: float) -> float:  # noqa: ARG002
        """Radius of its circle so far above or below its middle."""
        raise self.not_yet("how wide it is at its heights")

    def not_yet(self, what: str) -> InputError:
        """Error that says what of the shape palpate does not know."""
        return InputError(f"{self.with_article} as a fingertip: {what} is not known to palpate yet")
