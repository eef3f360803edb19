"""Result of `palpate study`, `palpate/study@1`, and the line format of its file of runs."""

from typing import Literal

from palpate.base.vocabulary import ErrorSource, IdentificationVerdict, PartMotion, Strategy
from palpate.config.fields import Interval, Out, Rounded


class RivalOut(Out):
    """Another state that was still possible after so many touches, in so many grips that touched anything."""

    object: str
    state: str
    touches: int
    grips: int = 0


class StudyRunOut(Out):
    """One simulated identification: what lay there, what it ended with, mm and rad.

    `variation`: what was varied, nothing if empty. `moved`: how far fingers moved the part in all.
    `inside_bounds`: the true state is among those that are left, and its true place within that one's bounds.
    `left`: states, object and name, that are still possible. `rivals`: others, those that lasted longest.
    `sticks_out`: the part was put so that it sticks out of the workspace, where answers do not hold.
    `grip_seconds`: rig time in grips; None for parts that lie still, whose touches take no time. `fewest`:
    touches that any strategy needs, with those up to the first that met the part; None if the part was lost.
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
    grip_seconds: Rounded | None = None
    fewest: int | None = None


class AccuracyOut(Out):
    """Accuracy that answers guarantee: half widths (mm, rad) of the bounds of `runs` identified ones.

    `position`, `orientation`: median, 90th percentile and largest. `within_goal`: runs whose bounds are both
    as narrow as the rig file's goals ask.
    """

    runs: int
    position: tuple[Rounded, Rounded, Rounded]
    orientation: tuple[Rounded, Rounded, Rounded]
    within_goal: int


class TwinsOut(Out):
    """States ("object, state") that no touch within reach tells apart, with which so many runs ended.

    One state: several places of it are left.
    """

    states: tuple[str, ...]
    runs: int


class StateStudiedOut(Out):
    """Ends of runs in which a state lay on the table. `touches`: median and 90th percentile.

    `position_error` (mm): median, of those that were identified. `drawn`: share of runs that draw it, on
    average, None if that is not known.
    """

    object: str
    state: str
    runs: int
    identified: int
    touches: tuple[Rounded, Rounded]
    position_error: Rounded | None
    indistinguishable: int = 0
    unresolved: int = 0
    accuracy: AccuracyOut | None = None
    drawn: Rounded | None = None


class PairStudiedOut(Out):
    """A state that lay there, and another that was taken for possible after touches, in so many runs.

    `touches`, `grips`: after which it was still possible, on average over these; grips that touched nothing
    do not count. `left`: runs that ended with it.
    """

    object: str
    state: str
    other_object: str
    other_state: str
    runs: int
    touches: Rounded
    left: int
    grips: Rounded = 0.0


class VerdictCountOut(Out):
    """Number of runs that ended with a verdict."""

    verdict: IdentificationVerdict
    runs: int


class TouchesOut(Out):
    """Touches that runs took. `fewest`: that any strategy needs on average, in the runs that were identified;
    `taken`: those that these runs took.
    """

    mean: Rounded
    median: Rounded
    p90: Rounded
    max: int
    fewest: Rounded | None = None
    taken: Rounded | None = None


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
    `position_bound`, `orientation_bound`: medians of runs that were identified both ways, `pairs` of these.
    `fewer_touches`: mean difference of these pairs, positive if varied runs take fewer, `fewer_interval`: its
    confidence interval. `shown`: what differs by more than chance, among "identified", "touches" and
    "bounds"; with 95 % confidence, for all comparisons of a list together. `runs_wanted`: with about so many
    a difference of half a touch would be shown; None if something is, or if no run differs.
    """

    runs: int
    touches: tuple[Rounded, Rounded]
    saved_touches: Rounded
    standard_error: Rounded
    identified: tuple[int, int]
    position_bound: tuple[Rounded, Rounded] | None
    orientation_bound: tuple[Rounded, Rounded] | None
    pairs: int = 0
    fewer_touches: Rounded | None = None
    fewer_interval: tuple[Rounded, Rounded] | None = None
    shown: tuple[Literal["identified", "touches", "bounds"], ...] = ()
    runs_wanted: int | None = None


class NoiseCostOut(ComparedOut):
    """Cost of an error: the same runs with half of it, with half the reach, or with the part held."""

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
    """Best heights of fingers (mm, in turn), and pairs of states that are alike there and as it is.

    `compared`: runs as they are beside the same ones with fingers there; None where that is the same.
    """

    heights: tuple[Rounded, ...]
    alike: int
    alike_now: int
    compared: ComparedOut | None


class StudyOut(Out):
    """Findings of a study. `wrong`: runs that named what did not lie there, or whose bounds do not hold.

    `lost`: runs that do not end with the truth still possible. `sticking_out`: runs whose part stuck out
    of the workspace; some of both may be among them. `seconds`: taken now, without runs that were kept
    before. `grips`, `position_error`, `moved` (mm), `grip_seconds` (None for parts that lie still): median
    and 90th percentile, the smallest value that 90 % of runs do not exceed. `verdicts`: the most
    frequent first. `hardest`: pairs that take most touches to tell apart. `touches_of`: runs by how many
    they took. `states`: those that were drawn, of `states_in_catalogue`. `noise_budget`: what errors
    cost, from a part of the runs. `heights`: those that fingers may be at.
    `placed_within` (mm): parts' centres of area lie within it round the middle of the workspace.
    `by_probability`: objects whose states are drawn by their probabilities, those of others are drawn
    evenly. `goal`: the rig file's, mm and rad. `max_grips`: its limit of grips, at which `stopped` unresolved
    runs ended. `accuracy`: what answers guarantee. `true_error` (mm), known to the simulator only: of
    identified runs, median, 90th percentile and largest. `twins`: what runs called indistinguishable ended
    with, the most frequent first.
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
    placed_within: Rounded | None = None
    by_probability: int = 0
    goal: tuple[Rounded, Rounded] | None = None
    max_grips: int | None = None
    stopped: int = 0
    grips_max: int = 0
    accuracy: AccuracyOut | None = None
    true_error: tuple[Rounded, Rounded, Rounded] | None = None
    twins: tuple[TwinsOut, ...] = ()
    grip_seconds: tuple[Rounded, Rounded] | None = None
