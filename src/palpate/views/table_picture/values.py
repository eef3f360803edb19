"""Values that a picture of a recognition shows, in W; mm and rad."""

import math
from dataclasses import dataclass

from palpate.base.geometry import Floats
from palpate.views import svg


@dataclass(frozen=True)
class BoundedPose:
    """A configuration with its certified bounds, each as (value, lo, hi)."""

    x_mm: tuple[float, float, float]
    y_mm: tuple[float, float, float]
    theta_rad: tuple[float, float, float]

    @property
    def turns_freely(self) -> bool:
        """True if every orientation is within the bounds, as of a round part."""
        _, lo, hi = self.theta_rad
        return hi - lo >= 2 * math.pi - 1e-9


@dataclass(frozen=True, eq=False)
class OtherHypothesis:
    """A hypothesis that is not the answer: `rings`, each (n, 2) mm in W, and why it is not or not yet.

    `reason` is a few words, such as "ruled out by grip 2" or "still possible, 12 %".
    """

    label: str
    reason: str
    rings: tuple[Floats, ...]


@dataclass(frozen=True)
class TouchMark:
    """One approach of one finger: the tip's centre went from `start_mm` to `end_mm`, touching or missing.

    `normal_rad`: the object's outward normals that the contact allows, counter-clockwise from lo to hi.
    `has_face`: the tip is a flat face across its way, `tip_radius_mm` half of its width; `points_mm`: where
    it was touched.
    """

    finger: str
    grip: int
    start_mm: tuple[float, float]
    end_mm: tuple[float, float]
    tip_radius_mm: float
    touched: bool
    normal_rad: tuple[float, float] | None = None
    has_face: bool = False
    points_mm: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class FingerBase:
    """Place where a finger stands."""

    name: str
    at_mm: tuple[float, float]


@dataclass(frozen=True)
class PredictedStop:
    """Outcome of an approach if a hypothesis is true: a stop after a travel `stop_mm` (lo, hi), or a miss.

    `stop_mm` is None if nothing can stop it. `words` say the same, a line each.
    """

    stop_mm: tuple[float, float] | None
    may_miss: bool
    words: tuple[str, ...]


@dataclass(frozen=True)
class ApproachArrow:
    """The planned path of a tip's centre, with the prediction of each of the picture's `others`."""

    finger: str
    start_mm: tuple[float, float]
    direction_rad: float
    travel_mm: float
    tip_radius_mm: float
    words: tuple[str, ...]
    predictions: tuple[PredictedStop, ...]

    def at(self, travel_mm: float) -> tuple[float, float]:
        """Return where the tip's centre is after a travel, W."""
        x, y = self.start_mm
        return (
            x + travel_mm * math.cos(self.direction_rad),
            y + travel_mm * math.sin(self.direction_rad),
        )


@dataclass(frozen=True, eq=False)
class Picture:
    """Everything that is drawn; whatever is empty or None is left out, legend entry included.

    `found`, `truth`: rings (n, 2) mm in W, holes among them, in either direction. `workspace_radius_mm`:
    circle about W's origin. `facts`: rows of name and value for the panel, such as ("touches", "5").
    `approaches`: the next grip; then `others` are the hypotheses that it is to tell apart.
    `has_legend`: False beside a picture that has one, with the whole table.
    """

    title: str
    subtitle: tuple[str, ...] = ()
    found: tuple[Floats, ...] = ()
    pose: BoundedPose | None = None
    truth: tuple[Floats, ...] = ()
    others: tuple[OtherHypothesis, ...] = ()
    touches: tuple[TouchMark, ...] = ()
    bases: tuple[FingerBase, ...] = ()
    workspace_radius_mm: float | None = None
    facts: tuple[tuple[str, str], ...] = ()
    approaches: tuple[ApproachArrow, ...] = ()
    has_legend: bool = True

    @property
    def colours(self) -> tuple[str, ...]:
        """Colours of the other hypotheses, in turn: one for each where their predictions are drawn too."""
        return svg.HUES if self.approaches else svg.BADGES

    def colour(self, index: int) -> str:
        """Colour of one of `others`."""
        return self.colours[index % len(self.colours)]
