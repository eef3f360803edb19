"""Result of `palpate identify`: `palpate/identification@1`."""

from enum import StrEnum
from typing import Literal

from palpate.base.vocabulary import IdentificationVerdict, PushResponse, Strategy
from palpate.config.result_model import BoundsOut, ConfigurationOut, Out, Rounded, UnfinishedOut


class Relation(StrEnum):
    """Relation of an alternative to the answer: another object or state, or the same state elsewhere."""

    TWIN = "twin"
    SYMMETRY = "symmetry"


class AlternativeOut(Out):
    """A hypothesis that is left beside the first one.

    `turned` (rad, −π to π) and `moved` (mm, of the state's centre of area) take the first one's configuration
    to this one; both are null for a twin.
    """

    object: str
    state: str
    configuration: ConfigurationOut
    bounds: BoundsOut
    weight: Rounded | None = None
    relation: Relation
    turned: Rounded | None
    moved: Rounded | None


class TruthOut(Out):
    """Truth that the emulator had put on the table; written after the run, unknown to all within it.

    Of the configurations that the state's symmetry makes equal, the one nearest to the answer is given.
    `named`: object and state are among the answers; then the errors (mm, rad) are those of that answer and
    `inside_bounds` says whether the truth is inside its bounds. All this is about the part as it lies when
    the fingers have left. `at_measurement`: where it was when each grip's contacts were measured, followed
    from how it was put, whatever its symmetry; null for a run that was recorded before this was noted.
    """

    object: str
    state: str
    configuration: ConfigurationOut
    named: bool
    inside_bounds: bool
    position_error_mm: Rounded | None
    orientation_error_rad: Rounded | None
    at_measurement: tuple[ConfigurationOut, ...] | None = None


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


class IdentificationOut(Out):
    """Answer of `palpate identify`.

    object, state, configuration and bounds are null if no hypothesis is left, `truth` on a real rig.
    `predicted`: touches that came out as all that was left had predicted. `stranger_probability`: that
    something outside the catalogue, different by 2 mm or more over a fifth of its outline from every part,
    would have agreed with all of these, had it agreed with the first contacts; null if none is left to agree
    with. `moved_before`: grips (from 1) before which the part seems to have been moved; what was felt before
    the last of them does not count. `detectable_shift` (mm): had the part been shifted before the last grip
    by more (and by 50 mm at most, where that had pads), that would surely have been noticed; null if that
    cannot be said. `calibration` is null if the run used none. `contacts`: so many of the touches met
    something. `swept`: none did, or none since the part was moved, and they leave no room in the workspace
    for any state of the catalogue that fingers can feel.
    `touch_records`: what loaded the part, touch by touch.
    `assumed_holds_n`: the declared force below which the part does not slide, on which the bounds rest; null
    if none is declared: then they rest on its lying still. `motion_bounds`: of every grip; empty if none is
    declared. `hold_contradicted`: the part was moved by more than that force allows, or it is none of the
    catalogue. `not_bounded`: states of the answer and of the alternatives in which the part may tip or roll
    when fingers push it; all bounds are for a part that does neither. `unfinished`: what the work budget did
    not suffice for; null if it did.
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
    strategy: Strategy
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
    unfinished: UnfinishedOut | None = None
