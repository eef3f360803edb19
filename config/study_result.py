"""Result of `palpate study`: `palpate/study@1`, and the lines of its file of runs."""

from typing import Literal

from palpate.config.results import Interval, Out, Rounded
from palpate.vocabulary import ErrorSource, IdentificationVerdict, PartMotion, Strategy

__all__ = [
    "BestHeightsOut",
    "ComparedOut",
    "ConfusionOut",
    "HeightOut",
    "NoiseCostOut",
    "PairStudiedOut",
    "RivalOut",
    "SeparatingStudiedOut",
    "StateStudiedOut",
    "StudyOut",
    "StudyRunOut",
    "TouchesOut",
    "VerdictCountOut",
]


class RivalOut(Out):
    """Another state that was still possible after so many touches."""

    object: str
    state: str
    touches: int


class StudyRunOut(Out):
    """One simulated identification: what lay there, what it ended with, mm and rad.

    `variation`: what was varied, nothing if empty. `moved`: how far fingers moved the part in all.
    `inside_bounds`: the true state is among those that are left, and its true place within that one's bounds.
    `left`: states, object and name, that are still possible. `rivals`: others, those that lasted longest.
    `sticks_out`: the part was put so that it sticks out of the workspace, where answers do not hold.
    """

    number: int
    variation: str = ""
    object: str
    state: str
    verdict: IdentificationVerdict
    named_object: str | None
    named_state: str | None
    inside_bounds: bool
    position_error: Rounded | None
    position_bound: Rounded | None
    orientation_bound: Rounded | None
    moved: Rounded
    grips: int
    touches: int
    left: tuple[tuple[str, str], ...]
    rivals: tuple[RivalOut, ...]
    sticks_out: bool = False


class StateStudiedOut(Out):
    """How runs ended in which a state lay on the table. `touches`: median and 90th percentile.

    `position_error` (mm): median, of those that were identified.
    """

    object: str
    state: str
    runs: int
    identified: int
    touches: tuple[Rounded, Rounded]
    position_error: Rounded | None


class PairStudiedOut(Out):
    """A state that lay there, and another that was taken for possible after touches, in so many runs.

    `touches`: after which it was still possible, on average over these. `left`: runs that ended with it.
    """

    object: str
    state: str
    other_object: str
    other_state: str
    runs: int
    touches: Rounded
    left: int


class VerdictCountOut(Out):
    """How many runs ended with a verdict."""

    verdict: IdentificationVerdict
    runs: int


class TouchesOut(Out):
    """Touches that runs took."""

    mean: Rounded
    median: Rounded
    p90: Rounded
    max: int


class ConfusionOut(Out):
    """State `a` lay there, and this share of its runs ended with `b` still possible: "object, state" each."""

    a: str
    b: str
    share: Rounded


class SeparatingStudiedOut(Out):
    """Heights (mm) at which a finger would tell two confused states apart; none if no one height would."""

    a: str
    b: str
    heights: tuple[Interval, ...]


class ComparedOut(Out):
    """Runs as they are beside the same ones varied: pairs of values, mm and rad.

    `touches`: means; `saved_touches`: mean difference, with its standard error. `identified`: how many.
    `position_bound`, `orientation_bound`: medians of runs that were identified both ways.
    """

    runs: int
    touches: tuple[Rounded, Rounded]
    saved_touches: Rounded
    standard_error: Rounded
    identified: tuple[int, int]
    position_bound: tuple[Rounded, Rounded] | None
    orientation_bound: tuple[Rounded, Rounded] | None


class NoiseCostOut(ComparedOut):
    """What an error costs: the same runs with half of it, or with half the reach."""

    source: ErrorSource


class HeightOut(Out):
    """Heights (mm) that are equally good for a finger.

    `alike`: pairs of states that fingers there never tell apart, or may not. `unmet`: states of which nothing
    is there.
    """

    range: Interval
    alike: int
    unmet: int


class BestHeightsOut(Out):
    """Where fingers should be (mm, in turn), and how many pairs of states are alike there and as it is.

    `compared`: runs as they are beside the same ones with fingers there; None where that is the same.
    """

    heights: tuple[Rounded, ...]
    alike: int
    alike_now: int
    compared: ComparedOut | None


class StudyOut(Out):
    """What a study found. `wrong`: runs that named what did not lie there, or whose bounds do not hold.

    `lost`: runs that do not end with the truth still possible. `sticking_out`: runs whose part stuck out
    of the workspace; some of both may be among them. `seconds`: taken now, without runs that were kept
    before. `grips`, `position_error`, `moved` (mm): median and 90th percentile. `verdicts`: the most
    frequent first. `hardest`: pairs that take most touches to tell apart. `touches_of`: runs by how many
    they took. `states`: those that were drawn, of `states_in_catalogue`. `noise_budget`: what errors
    cost, from a part of the runs. `heights`: those that fingers may be at.
    """

    format: Literal["palpate/study@1"] = "palpate/study@1"
    units: Literal["mm, rad"] = "mm, rad"
    objects: str
    rig: str
    strategy: Strategy
    seed: int
    parts: PartMotion
    runs: int
    wrong: int
    lost: int
    sticking_out: int
    seconds: Rounded
    verdicts: tuple[VerdictCountOut, ...]
    grips: tuple[Rounded, Rounded]
    touches: TouchesOut
    touches_of: dict[int, int]
    moved: tuple[Rounded, Rounded]
    position_error: tuple[Rounded, Rounded] | None
    states: tuple[StateStudiedOut, ...]
    states_in_catalogue: int
    confusion: tuple[ConfusionOut, ...]
    hardest: tuple[PairStudiedOut, ...]
    separating: tuple[SeparatingStudiedOut, ...]
    heights: tuple[HeightOut, ...]
    best_heights: BestHeightsOut | None
    noise_budget: tuple[NoiseCostOut, ...]
    wrong_runs: tuple[StudyRunOut, ...]
