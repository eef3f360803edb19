"""Result of `palpate recognize`: `palpate/recognition@1`."""

from typing import Literal

from palpate.base.vocabulary import RecognitionVerdict
from palpate.config.results import BoundsOut, ConfigurationOut, Out, Rounded, UnfinishedOut

__all__ = [
    "ExplanationOut",
    "FeltOut",
    "HypothesisOut",
    "InterpretationOut",
    "LevelOut",
    "MemoOut",
    "RecognitionOut",
    "SlideOut",
    "StatisticsOut",
    "StepOut",
    "WhyOut",
]


class InterpretationOut(Out):
    """What each contact in turn is paired with, counted from 0 as in the objects file.

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
    """What the search did; `memo` is what the memo's own algorithm would have had to do."""

    levels: tuple[LevelOut, ...]
    model_tests: int
    seconds: Rounded
    memo: MemoOut | None = None


class FeltOut(Out):
    """Which contact or miss is meant; `grip` is its index in the contacts file, from 0."""

    grip: int
    finger: str
    touched: bool


class ExplanationOut(Out):
    """What may be the matter when nothing fits.

    `moved_after_grip`: how many of the first grips fit together, if each grip fits alone but not all do; the
    object may have moved after them. `spurious`: contacts that leave something that fits when they are left
    out, one at a time beside those that were allowed already.
    """

    moved_after_grip: int | None
    spurious: tuple[FeltOut, ...]


class StepOut(Out):
    """How many interpretations of one object are left after a test of some contacts."""

    reason: str
    contacts: tuple[FeltOut, ...]
    left: int


class WhyOut(Out):
    """Whether and why one object (`state` null: in any of its states) was ruled out.

    The last of `steps` ruled it out if it leaves nothing. Then the contacts of `conflict` cannot all be true
    of the object, and none of them can be left out. Else its `hypotheses` are given. No contact counts as
    spurious.
    """

    object: str
    state: str | None
    ruled_out: bool
    steps: tuple[StepOut, ...]
    conflict: tuple[FeltOut, ...]
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
    why: WhyOut | None = None
