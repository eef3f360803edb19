"""Result of `palpate plan`: `palpate/grip@1`, the next grip and what each hypothesis says it will feel."""

from typing import Literal

from palpate.base.vocabulary import RecognitionVerdict, Strategy
from palpate.config.results import BoundsOut, ConfigurationOut, Interval, Out, Rounded

__all__ = ["ApproachOut", "AssumptionsOut", "GripOut", "PossibleOut", "PredictionOut"]


class PossibleOut(Out):
    """A hypothesis that agrees with every contact so far; predictions name it by its index."""

    object: str
    state: str
    configuration: ConfigurationOut
    bounds: BoundsOut
    weight: Rounded
    symmetry_order: int


class PredictionOut(Out):
    """What an approach will meet if a hypothesis is true, over the whole of its bounds.

    `hypothesis`: index among the grip's hypotheses. `stop`: [lo, hi] of the travel (mm) after which the
    finger is stopped; null if nothing can stop it. `may_miss`: perhaps nothing stops it. `normal`: [lo, hi]
    of the surface's outward normal there, rad, counter-clockwise from lo to hi; null with `stop`.
    """

    hypothesis: int
    stop: Interval | None
    may_miss: bool
    normal: Interval | None


class ApproachOut(Out):
    """One finger's part: the tip's centre goes straight from `start` along `direction` (mm, rad, W).

    If it is not stopped within `travel`, it has missed. `position_bound`: the tip's true centre is within
    this distance (mm) of the given one all along the path.
    """

    finger: str
    start: tuple[Rounded, Rounded]
    direction: Rounded
    travel: Rounded
    position_bound: Rounded
    predictions: tuple[PredictionOut, ...]


class AssumptionsOut(Out):
    """What `decisive` takes for granted of the touches, beside each approach's `position_bound`.

    `normal_half_range`: a touch tells the surface's normal to within this, rad, either way.
    """

    normal_half_range: Rounded


class GripOut(Out):
    """Answer of `palpate plan`.

    `fine`: something is left, and every hypothesis's bounds are as narrow as the rig file's goals. Without a
    grip `approaches` is empty, and `decisive`, `remaining` and `seconds` are null. `decisive`:
    whatever the fingers feel, hypotheses are left of which no two are told apart by anything within reach.
    `remaining`: expected share of what needs telling apart that will still feel alike; null if the strategy
    does not foresee it. `seconds`: estimated time. `indistinguishable`: sets of hypotheses, by index, of
    which no approach that is left tells any two apart; it is empty if there are none.
    """

    format: Literal["palpate/grip@1"] = "palpate/grip@1"
    units: Literal["mm, rad"] = "mm, rad"
    strategy: Strategy
    verdict: RecognitionVerdict
    fine: bool
    hypotheses: tuple[PossibleOut, ...]
    approaches: tuple[ApproachOut, ...]
    decisive: bool | None
    remaining: Rounded | None
    seconds: Rounded | None
    assumes: AssumptionsOut
    indistinguishable: tuple[tuple[int, ...], ...]
