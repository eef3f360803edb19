"""Results of `palpate recognize`, `plan` and `identify`: formats `recognition@1`, `grip@1`,
`identification@1`.
"""

from enum import StrEnum
from typing import Literal

from pydantic import SerializerFunctionWrapHandler, model_serializer

from palpate.base.vocabulary import (
    BoundSource,
    ContradictionCause,
    IdentificationVerdict,
    PushResponse,
    RecognitionVerdict,
    RunLimit,
    SetUpFault,
    Strategy,
)
from palpate.config.fields import BoundsOut, ConfigurationOut, Interval, Out, Rounded, UnfinishedOut


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


class UnknownStateOut(Out):
    """A state that is not known at the fingers' heights: a part that rests so is not recognised.

    `probability`: of the part's coming to rest so; null if its file does not say.
    """

    object: str
    state: str
    probability: Rounded | None


class RecognitionOut(Out):
    """Answer of `palpate recognize`; `explanation` goes with the verdict none, `why` with --why.

    `unfinished` is null if the work budget was enough; `left_out`: states that were not looked for.
    """

    format: Literal["palpate/recognition@1"] = "palpate/recognition@1"
    units: Literal["mm, rad"] = "mm, rad"
    verdict: RecognitionVerdict
    hypotheses: tuple[HypothesisOut, ...]
    statistics: StatisticsOut
    unfinished: UnfinishedOut | None = None
    explanation: ExplanationOut | None = None
    why: ObjectExplanationOut | None = None
    left_out: tuple[UnknownStateOut, ...] = ()


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
    which no approach that is left tells any two apart; it is empty if there are none. `left_out`: states of
    the file that were not looked for.
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
    left_out: tuple[UnknownStateOut, ...] = ()


class Relation(StrEnum):
    """Relation of an alternative to the answer: another object or state, or the same state elsewhere.

    Near: another state of the same object, whose configuration agrees within the rig file's goals.
    """

    TWIN = "twin"
    NEAR = "near"
    SYMMETRY = "symmetry"


class AlternativeOut(Out):
    """A hypothesis that is left beside the first one.

    `turned` (rad, −π to π) and `moved` (mm, of the state's centre of area) take the first one's configuration
    to this one; both are null for another state.
    """

    object: str
    state: str
    configuration: ConfigurationOut
    bounds: BoundsOut
    weight: Rounded | None = None
    relation: Relation
    turned: Rounded | None
    moved: Rounded | None


class PlacedOut(Out):
    """Part on an emulated table, as it lies when the fingers have left."""

    object: str
    state: str
    configuration: ConfigurationOut


class TruthOut(Out):
    """Truth that the emulator had put on the table; written after the run, unknown to all within it.

    Of the configurations that the state's symmetry makes equal, the one nearest to the answer is given.
    `named`: object and state are among the answers; then the errors (mm, rad) are those of that answer and
    `inside_bounds` says whether the truth is inside its bounds. All this is about the part as it lies when
    the fingers have left. `at_measurement`: where it was when each grip's contacts were measured, followed
    from how it was put, whatever its symmetry; null for a run that was recorded before this was noted.
    Of several parts this is the one which the answer fits best; the key `others` is there only then.
    """

    object: str
    state: str
    configuration: ConfigurationOut
    named: bool
    inside_bounds: bool
    position_error_mm: Rounded | None
    orientation_error_rad: Rounded | None
    at_measurement: tuple[ConfigurationOut, ...] | None = None
    others: tuple[PlacedOut, ...] = ()

    # A return type would take the place of the keys in the JSON Schema.
    @model_serializer(mode="wrap")
    def _without_no_others(self, write: SerializerFunctionWrapHandler):  # type: ignore[no-untyped-def]
        found = write(self)
        return found if self.others else {key: value for key, value in found.items() if key != "others"}


class CalibrationUsedOut(Out):
    """The calibration that a run used, and whether what it felt agrees with it.

    `made`: date and time in UTC. `age_days`: when the run began. `residual_rms_mm`: root mean square of how
    far contacts are from the identified object's outline at its best pose, along the normal;
    `expected_rms_mm`: what the calibration lets expect. `drifted`: they differ by more than chance explains
    in 999 of 1000 runs. These three are null where that cannot be said: nothing was identified, contacts were
    too few, or the calibration does not bound them.
    """

    made: str
    age_days: int
    residual_rms_mm: Rounded | None
    expected_rms_mm: Rounded | None
    drifted: bool | None


class TouchRecordOut(Out):
    """Load on the part by one stage of a finger's touch, as measured; docs/rig-file.md says how.

    `stage`: "quick" finds the part, "slow" measures it. `travel_in_contact_mm`: forwards, once it touched.
    """

    grip: int
    finger: str
    stage: Literal["quick", "slow"]
    peak_force_n: Rounded
    travel_in_contact_mm: Rounded
    work_mj: Rounded


class MotionBoundOut(Out):
    """How far a grip may have moved the part until its fingers had left: its centroid's `position` (mm) and
    `orientation` (rad); null where there is no bound.
    """

    grip: int
    position: Rounded | None
    orientation: Rounded | None


class NotBoundedOut(Out):
    """A state in which fingers may have tipped or rolled the part: then no bound holds.

    `when_pushed`: which of the two. `why`: in one line.
    """

    object: str
    state: str
    when_pushed: Literal[PushResponse.MAY_TIP, PushResponse.MAY_ROLL]
    why: str


class SetUpDoubtOut(Out):
    """A hint, never an answer: a rig that is wrong in one thing explains contacts that fit nothing.

    `what` is wrong, with one `finger` or, where null, with all. `explains`: as many contacts, which are all,
    or all but those of that finger for `what` "finger". `joint`: which of its servos. `value` (from, to): by
    how much the joint is off (mm or rad), the array is turned (rad), or by what factor the rig file's size,
    or travel is to be multiplied; null where there is none.
    """

    what: SetUpFault
    finger: str | None
    explains: int
    joint: str | None = None
    value: Interval | None = None


class WidthsWithoutOut(Out):
    """Half-widths (mm, rad) that an answer's bounds would have if one of their sources were nil."""

    source: BoundSource
    position: Rounded
    orientation: Rounded


class ContradictionOut(Out):
    """Grips that nothing in the catalogue explains together: `grip` (from 1) contradicts the earlier ones.

    In the grip `repeated_in` the touches of an earlier one were made again (null: none were); `touches` of
    them met something both times, `apart` (mm) at most from where they had (null: one met something only
    once). What they met may have moved by `hidden` (mm) without showing it (null: nothing was met). `cause`:
    "moved" if they show that it moved, "not-in-catalogue" if no motion that need not have shown explains the
    grips, "either" if touches do not say which.
    """

    grip: int
    cause: ContradictionCause
    repeated_in: int | None = None
    touches: int = 0
    apart: Rounded | None = None
    hidden: Rounded | None = None


class PartOut(Out):
    """One of several parts on a table: its verdict, and the answer as `IdentificationOut` has it.

    `agreed`: every way that is left to divide the touches among parts has this part, with these touches.
    """

    verdict: IdentificationVerdict
    agreed: bool
    object: str | None
    state: str | None
    configuration: ConfigurationOut | None
    bounds: BoundsOut | None
    alternatives: tuple[AlternativeOut, ...]
    symmetry_order: int
    contacts: int
    predicted: int
    stranger_probability: Rounded | None
    goal_met: bool | None
    truth: TruthOut | None


class TableOut(Out):
    """The table on which several parts were sought: how many, as asked, and what else may be there.

    `divisions`: ways that are left to divide the touches among parts. `complete`: as many as were asked for
    were found, or no state of the catalogue has room for one more. `rest_radius` (mm): in the rest of the
    workspace nothing has a section, at the heights `rest_heights`, in which a larger circle fits.
    """

    asked: str
    divisions: int
    complete: bool
    rest_radius: Rounded
    rest_heights: Interval


class IdentificationOut(Out):
    """Answer of `palpate identify`.

    object, state, configuration and bounds are null if no hypothesis is left, `truth` on a real rig.
    `predicted`: touches that came out as all that was left had predicted. `stranger_probability`: that
    something outside the catalogue, different by 2 mm or more over a fifth of its outline from every part,
    would have agreed with all of these, had it agreed with the first contacts; null if none is left to agree
    with. `altered_probability`: the same of what differs by less, or over less of its outline, as a part does
    of which one feature was moved, added or left out. `moved_before`: grips (from 1) before which the part
    seems to have been moved; what was felt before the last of them does not count. `detectable_shift` (mm):
    had the part been shifted before the last grip by more (and by 50 mm at most, where that had pads), that
    would surely have been noticed; null if that cannot be said. `calibration` is null if the run used none.
    `contacts`: so many of the touches met something. `swept`: none did, or none since the part was moved, and
    they leave no room in the workspace for any state of the catalogue that fingers can feel.
    `touch_records`: what loaded the part, touch by touch.
    `assumed_holds_n`: the declared force below which the part does not slide, on which the bounds rest; null
    if none is declared: then they rest on its lying still. `motion_bounds`: of every grip; empty if none is
    declared. `hold_contradicted`: the part was moved by more than that force allows, or it is none of the
    catalogue. `not_bounded`: states of the answer and of the alternatives in which the part may tip or roll
    when fingers push it; all bounds are for a part that does neither. `setup_doubts`: where nothing fits,
    wrong set-ups that would explain it. `unfinished`: what the work budget did
    not suffice for; null if it did. `notices`: what devices showed in the run that is not as the rig file
    declares, and that bounds may not cover. `goal_met`: `bounds`, and those of the alternatives, are as
    narrow as the rig file's goals; null without an answer. `limit`: the rig file's limit that the run
    came to before its goal. Where that is null and `goal_met` false, no grip within reach promised to place
    it much more finely. `contradictions`: grips that contradicted earlier ones, and why. `narrower_without`:
    half-widths of `bounds` if one source were nil: fingers' places, dents of tips, normals, motion of the
    part, its tolerance; those that matter, the most costly first; an estimate, to first order. `left_out`:
    states of the file that were not looked for. Where several parts were sought, `verdict` is that of the
    whole table, `parts` holds each of them, and object, configuration and what belongs to them are those of
    the first one; `table` is null where one was.
    """

    format: Literal["palpate/identification@1"] = "palpate/identification@1"
    units: Literal["mm, rad"] = "mm, rad"
    verdict: IdentificationVerdict
    object: str | None
    state: str | None
    configuration: ConfigurationOut | None
    bounds: BoundsOut | None
    alternatives: tuple[AlternativeOut, ...]
    symmetry_order: int
    strategy: Strategy | Literal["own"]
    grips: int
    touches: int
    touch_records: tuple[TouchRecordOut, ...] = ()
    contacts: int = 0
    swept: bool = False
    predicted: int
    stranger_probability: Rounded | None = None
    moved_before: tuple[int, ...]
    detectable_shift: Rounded | None
    emulated: bool
    rig_seconds: Rounded
    wall_seconds: Rounded
    session: str | None
    calibration: CalibrationUsedOut | None = None
    truth: TruthOut | None = None
    motion_bounds: tuple[MotionBoundOut, ...] = ()
    assumed_holds_n: Rounded | None = None
    hold_contradicted: bool = False
    not_bounded: tuple[NotBoundedOut, ...] = ()
    setup_doubts: tuple[SetUpDoubtOut, ...] = ()
    notices: tuple[str, ...] = ()
    unfinished: UnfinishedOut | None = None
    goal_met: bool | None = None
    limit: RunLimit | None = None
    contradictions: tuple[ContradictionOut, ...] = ()
    altered_probability: Rounded | None = None
    narrower_without: tuple[WidthsWithoutOut, ...] = ()
    left_out: tuple[UnknownStateOut, ...] = ()
    parts: tuple[PartOut, ...] = ()
    table: TableOut | None = None
