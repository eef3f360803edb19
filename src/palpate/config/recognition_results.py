"""Results of `palpate recognize` (`palpate/recognition@1`) and `palpate plan` (`palpate/grip@1`)."""

from typing import Literal

from palpate.base.vocabulary import RecognitionVerdict, Strategy
from palpate.config.result_model import BoundsOut, ConfigurationOut, Interval, Out, Rounded, UnfinishedOut


class InterpretationOut(Out):
    """Edges that the contacts in turn are paired with, counted from 0 as in the objects file.

    `edges`: the edge; for a tip on a corner, the edge that begins there. `features` says which: "edge 3",
    "vertex 5". Both are null for a contact that is taken as spurious or is
    not paired (`unfinished`).
    """

    edges: tuple[int | None, ...]
    features: tuple[str | None, ...]


class SlideOut(Out):
    """A one-parameter family: the position may move along `direction` by `extent` (lo, hi), rad and mm."""

    direction: Rounded
    extent: tuple[Rounded, Rounded]


class HypothesisOut(Out):
    """An object in a state and a region of configurations that agree with every contact.

    `spurious` names the fingers of those touches that would not be the object's; without any, all agree.
    """

    object: str
    state: str
    configuration: ConfigurationOut
    bounds: BoundsOut
    weight: Rounded
    verified: bool
    symmetry_order: int
    interpretations: tuple[InterpretationOut, ...]
    spurious: tuple[str, ...] = ()
    slide: SlideOut | None = None


class LevelOut(Out):
    """Counts of one level of the interpretation tree."""

    level: int
    candidates: int
    after_distance: int
    after_angle: int


class MemoOut(Out):
    """Columns 1, 2, 2D, 2A, 3, 3D, 3A, … M of the memo's Table I; 1, 2, 2A, 2D, … M of Table II."""

    distance_first: tuple[int, ...]
    angle_first: tuple[int, ...]


class StatisticsOut(Out):
    """Work of the search; `memo` is what the memo's own algorithm would have had to do."""

    levels: tuple[LevelOut, ...]
    model_tests: int
    seconds: Rounded
    memo: MemoOut | None = None


class ContactReferenceOut(Out):
    """Reference to a contact or miss; `grip` is its index in the contacts file, from 0."""

    grip: int
    finger: str
    touched: bool


class ExplanationOut(Out):
    """Possible reasons why nothing fits.

    `moved_after_grip`: how many of the first grips fit together, if each grip fits alone but not all do; the
    object may have moved after them. `spurious`: contacts that leave something that fits when they are left
    out, one at a time beside those that were allowed already.
    """

    moved_after_grip: int | None
    spurious: tuple[ContactReferenceOut, ...]


class EliminationStepOut(Out):
    """Number of interpretations of one object that are left after a test of some contacts."""

    reason: str
    contacts: tuple[ContactReferenceOut, ...]
    left: int


class ObjectExplanationOut(Out):
    """Reason why one object (`state` null: in any of its states) was ruled out, if it was.

    The last of `steps` ruled it out if it leaves nothing. Then the contacts of `conflict` cannot all be true
    of the object, and none of them can be left out. Else its `hypotheses` are given. No contact counts as
    spurious.
    """

    object: str
    state: str | None
    ruled_out: bool
    steps: tuple[EliminationStepOut, ...]
    conflict: tuple[ContactReferenceOut, ...]
    hypotheses: tuple[HypothesisOut, ...]


class RecognitionOut(Out):
    """Answer of `palpate recognize`; `explanation` goes with the verdict none, `why` with --why.

    `unfinished` is null if the work budget was enough.
    """

    format: Literal["palpate/recognition@1"] = "palpate/recognition@1"
    units: Literal["mm, rad"] = "mm, rad"
    verdict: RecognitionVerdict
    hypotheses: tuple[HypothesisOut, ...]
    statistics: StatisticsOut
    unfinished: UnfinishedOut | None = None
    explanation: ExplanationOut | None = None
    why: ObjectExplanationOut | None = None


class PossibleHypothesisOut(Out):
    """A hypothesis that agrees with every contact so far; predictions name it by its index."""

    object: str
    state: str
    configuration: ConfigurationOut
    bounds: BoundsOut
    weight: Rounded
    symmetry_order: int


class PredictionOut(Out):
    """Prediction of what an approach meets if a hypothesis is true, over the whole of its bounds.

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
    """Assumptions of `decisive` on the touches, beside each approach's `position_bound`.

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
    hypotheses: tuple[PossibleHypothesisOut, ...]
    approaches: tuple[ApproachOut, ...]
    decisive: bool | None
    remaining: Rounded | None
    seconds: Rounded | None
    assumes: AssumptionsOut
    indistinguishable: tuple[tuple[int, ...], ...]
