"""Results as JSON: `palpate/recognition@1` and `palpate/identification@1`. The far end of the data's way.

The keys come out in the order declared here, numbers rounded to a fixed number of decimals (bounds
outward), so that two runs with one seed can be compared byte by byte. A number that is not finite is a bug
and raises.
"""

import json
import math
from enum import StrEnum
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

__all__ = [
    "DECIMALS",
    "AlternativeOut",
    "BoundsOut",
    "ConfigurationOut",
    "ExplanationOut",
    "FeltOut",
    "HypothesisOut",
    "IdentificationOut",
    "IdentificationVerdict",
    "InterpretationOut",
    "LevelOut",
    "MemoOut",
    "RecognitionOut",
    "RecognitionVerdict",
    "SlideOut",
    "StatisticsOut",
    "StepOut",
    "TruthOut",
    "WhyOut",
    "to_json",
]

DECIMALS = 6
"""Decimals of every number written: nanometres, microradians, microseconds."""


def _rounded(value: float) -> float:
    return round(value, DECIMALS) + 0.0  # + 0.0 turns -0.0 into 0.0


def _rounded_outward(interval: tuple[float, float]) -> tuple[float, float]:
    """Widen to whole decimals: a bound that was rounded inward would no longer be one."""
    scale = 10**DECIMALS
    lo, hi = math.floor(interval[0] * scale), math.ceil(interval[1] * scale)
    lo -= lo / scale > interval[0]
    hi += hi / scale < interval[1]
    return lo / scale, hi / scale


Rounded = Annotated[float, Field(allow_inf_nan=False), AfterValidator(_rounded)]
_Finite = Annotated[float, Field(allow_inf_nan=False)]
Interval = Annotated[tuple[_Finite, _Finite], AfterValidator(_rounded_outward)]


class RecognitionVerdict(StrEnum):
    """What the contacts say about the catalogue."""

    UNIQUE = "unique"
    AMBIGUOUS = "ambiguous"
    NONE = "none"


class IdentificationVerdict(StrEnum):
    """How a run on the bench ended."""

    IDENTIFIED = "identified"
    INDISTINGUISHABLE = "indistinguishable"
    UNKNOWN = "unknown"
    UNRESOLVED = "unresolved"


class _Out(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ConfigurationOut(_Out):
    """Maps object coordinates as given in the objects file to the support plane: mm, mm, rad."""

    x: Rounded
    y: Rounded
    theta: Rounded


class BoundsOut(_Out):
    """[lo, hi] of each coordinate; `theta` may exceed ±π rather than wrap."""

    x: Interval
    y: Interval
    theta: Interval


class InterpretationOut(_Out):
    """What each contact in turn is paired with, counted from 0 as in the objects file.

    `edges`: the edge; for a tip on a corner, the edge that begins there. `features` says which: "edge 3",
    "vertex 5". Both are null for a contact that is taken as spurious.
    """

    edges: tuple[int | None, ...]
    features: tuple[str | None, ...]


class SlideOut(_Out):
    """A one-parameter family: the position may move along `direction` by `extent` (lo, hi), rad and mm."""

    direction: Rounded
    extent: tuple[Rounded, Rounded]


class HypothesisOut(_Out):
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


class LevelOut(_Out):
    """Counts of one level of the interpretation tree."""

    level: int
    candidates: int
    after_distance: int
    after_angle: int


class MemoOut(_Out):
    """Columns 1, 2, 2D, 2A, 3, 3D, 3A, … M of the memo's Table I; 1, 2, 2A, 2D, … M of Table II."""

    distance_first: tuple[int, ...]
    angle_first: tuple[int, ...]


class StatisticsOut(_Out):
    """What the search did; `memo` is what the memo's own algorithm would have had to do."""

    levels: tuple[LevelOut, ...]
    model_tests: int
    seconds: Rounded
    memo: MemoOut | None = None


class FeltOut(_Out):
    """Which contact or miss is meant; `grip` is its index in the contacts file, from 0."""

    grip: int
    finger: str
    touched: bool


class ExplanationOut(_Out):
    """What may be the matter when nothing fits.

    `moved_after_grip`: how many of the first grips fit together, if each grip fits alone but not all do; the
    object may have moved after them. `spurious`: contacts that leave something that fits when they are left
    out, one at a time beside those that were allowed already.
    """

    moved_after_grip: int | None
    spurious: tuple[FeltOut, ...]


class StepOut(_Out):
    """How many interpretations of one object are left after a test of some contacts."""

    reason: str
    contacts: tuple[FeltOut, ...]
    left: int


class WhyOut(_Out):
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


class RecognitionOut(_Out):
    """Answer of `palpate recognize`; `explanation` goes with the verdict none, `why` with --why."""

    format: Literal["palpate/recognition@1"] = "palpate/recognition@1"
    verdict: RecognitionVerdict
    hypotheses: tuple[HypothesisOut, ...]
    statistics: StatisticsOut
    explanation: ExplanationOut | None = None
    why: WhyOut | None = None


class AlternativeOut(_Out):
    """A hypothesis that is left beside the first one."""

    object: str
    state: str
    configuration: ConfigurationOut
    bounds: BoundsOut
    weight: Rounded | None = None


class TruthOut(_Out):
    """What the emulator had put on the table; written after the run, unknown to everything in it.

    Of the configurations that the state's symmetry makes equal, the one nearest to the answer is given.
    `named`: object and state are among the answers; then the errors (mm, rad) are those of that answer and
    `inside_bounds` says whether the truth is inside its bounds.
    """

    object: str
    state: str
    configuration: ConfigurationOut
    named: bool
    inside_bounds: bool
    position_error_mm: Rounded | None
    orientation_error_rad: Rounded | None


class IdentificationOut(_Out):
    """Answer of `palpate identify`.

    object, state, configuration and bounds are null if no hypothesis is left, `truth` on a real rig.
    """

    format: Literal["palpate/identification@1"] = "palpate/identification@1"
    verdict: IdentificationVerdict
    object: str | None
    state: str | None
    configuration: ConfigurationOut | None
    bounds: BoundsOut | None
    alternatives: tuple[AlternativeOut, ...]
    symmetry_order: int
    grips: int
    touches: int
    emulated: bool
    rig_seconds: Rounded
    wall_seconds: Rounded
    session: str | None
    truth: TruthOut | None = None


def to_json(result: BaseModel, *, indent: int | None = None) -> str:
    """Write `result` as one JSON object: declared key order, rounded numbers, no NaN (ValueError)."""
    return json.dumps(result.model_dump(mode="json"), indent=indent, allow_nan=False, ensure_ascii=False)
