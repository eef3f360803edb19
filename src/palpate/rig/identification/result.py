"""A run of an identification: its inputs, its results, and `palpate/identification@1`."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from typing import Literal

from palpate.base.errors import InputError, PalpateError
from palpate.base.short_repr import ShortRepr
from palpate.base.vocabulary import Strategy
from palpate.config import CalibrationFile, RigFile
from palpate.config.fields import UnfinishedOut
from palpate.config.recognition_results import (
    AlternativeOut,
    CalibrationUsedOut,
    ContradictionOut,
    IdentificationOut,
    MotionBoundOut,
    NotBoundedOut,
    PartOut,
    Relation,
    SetUpDoubtOut,
    TableOut,
    TouchRecordOut,
    WidthsWithoutOut,
)
from palpate.config.wiring_record import ConfirmedWiring
from palpate.recognizer import Catalogue, Configuration, Hypothesis, Recognition, near_equal
from palpate.rig.conversion import goals_of
from palpate.rig.emulated.ground_truth import compare_answers
from palpate.rig.emulated.hidden_truth import PartTruth
from palpate.rig.emulated.scene import Placement
from palpate.rig.identification.accuracy import widths_by_source
from palpate.rig.identification.contradiction import Contradiction
from palpate.rig.identification.doubt import SetUpDoubt
from palpate.rig.identification.grip_choice import StabilityTable
from palpate.rig.identification.motion_bounds import MotionBounds
from palpate.rig.identification.outcome import Identification
from palpate.rig.identification.part_count import ONE_PART, PartCount
from palpate.rig.identification.rig_recognition import GripStrategy, name_strategy


@dataclass(frozen=True, eq=False)
class Truth:
    """What lay on an emulated table, in the frame of the answers.

    `placements`: how the parts lay when the fingers had left. `at_measurement`: where each of them was when
    each grip's contacts were measured, None if that was not noted.
    """

    placements: tuple[Placement, ...]
    at_measurement: Sequence[Sequence[Configuration]] | None = None

    def values(self, parts: Sequence[PartTruth]) -> dict[str, object]:
        """Values of the event: the first part's, and the `others`, if there are.

        `parts`: how each of them moves, empty if nothing moves them.
        """
        first, *others = (
            self._values_of(number, parts[number] if parts else None)
            for number in range(len(self.placements))
        )
        return first | ({"others": others} if others else {})

    def _values_of(self, number: int, part: PartTruth | None) -> dict[str, object]:
        lies = self.placements[number]
        return {
            "object": lies.model.name,
            "state": lies.state.name,
            "configuration": lies.configuration,
            "at_measurement": None if self.at_measurement is None else self.at_measurement[number],
            "part": part and asdict(part) | {"slip_n": part.slip_n},
        }


@dataclass(frozen=True)
class WiringProof:
    """Proof that a run asks for on real devices: what was confirmed, if anything, of the rig as described.

    `command`: the one that proves the wiring.
    """

    described: RigFile
    confirmed: ConfirmedWiring | None
    command: str

    def check(self, arrays: Mapping[str, str]) -> None:
        """Raise InputError if that was not proven of these devices; `arrays`: unique ids by finger."""
        why = "was never confirmed"
        if self.confirmed is not None:
            changed = self.confirmed.difference(self.described, arrays)
            if changed is None:
                return
            why = f"is not as it was confirmed on {self.confirmed.made:%Y-%m-%d}: {changed}"
        raise InputError(
            f"the wiring of this rig {why}; a finger with another's array presses unfelt: prove it with "
            f"`{self.command}`; `palpate identify --unconfirmed` (unconfirmed=True) runs it all the same"
        )


@dataclass(frozen=True, eq=False, repr=False)
class IdentificationJob(ShortRepr):
    """What a run starts from; `placements`, in the answer's frame: what an emulated table is set with.

    `calibration` is in `rig` already, and refused if other devices are connected than it was made with.
    `started`: when the run began, from which the calibration's age counts; None: the answer tells nothing of
    the calibration. `proof`: of the wiring, asked for before torque is on; None: none is.
    """

    rig: RigFile
    catalogue: Catalogue
    placements: tuple[Placement, ...]
    strategy: Strategy | GripStrategy
    seed: int
    calibration: CalibrationFile | None = None
    started: datetime | None = None
    proof: WiringProof | None = None
    parts: PartCount = ONE_PART

    @property
    def strategy_name(self) -> Strategy | Literal["own"]:
        """Name of the strategy in results and logs."""
        return name_strategy(self.strategy)


@dataclass(frozen=True, eq=False, repr=False)
class IdentificationRun(ShortRepr):
    """A run that has ended, and the rig's own time (s) at its end.

    `truth`: what lay on an emulated table and where, in the answer's frame, to be compared with the answer.
    `calibration`: what there is to say of the calibration; None if the run used none.
    `doubts`: wrong set-ups that explain contacts which fit nothing. `late_failure`: an observer or the
    display failed at the end; that has no part in the result. `notices`: what arrays showed that is not as
    declared.
    """

    job: IdentificationJob
    result: Identification
    emulated: bool
    rig_seconds: float
    truth: Truth | None
    calibration: CalibrationUsedOut | None
    late_failure: PalpateError | None
    doubts: Sequence[SetUpDoubt] = ()
    notices: tuple[str, ...] = ()

    def out(self, *, wall_seconds: float, session: str | None) -> IdentificationOut:
        """Return `palpate/identification@1`: the heaviest hypothesis first, the others beside it."""
        result, truth = self.result, self.truth
        hypotheses = hypotheses_of(result)
        first = hypotheses[0] if hypotheses else None
        shift_mm = result.detectable_shift_mm
        return IdentificationOut(
            verdict=result.outcome,
            object=first and first.state.object_name,
            state=first and first.state.state.name,
            configuration=first and first.configuration,
            bounds=first and first.bounds,
            alternatives=self._alternatives(hypotheses),
            symmetry_order=1 if first is None else first.state.symmetry_order,
            strategy=self.job.strategy_name,
            grips=len(result.grips),
            touches=result.touches,
            touch_records=_touch_records(result),
            contacts=sum(touch.contact.touched for grip in result.grips for touch in grip),
            swept=result.swept,
            predicted=result.predicted,
            stranger_probability=result.stranger_probability,
            moved_before=result.moved_before,
            detectable_shift=shift_mm if math.isfinite(shift_mm) else None,
            emulated=self.emulated,
            rig_seconds=self.rig_seconds,
            wall_seconds=wall_seconds,
            session=session,
            calibration=self.calibration,
            motion_bounds=tuple(
                MotionBoundOut(grip=number, position=bound and bound[0], orientation=bound and bound[1])
                for number, bound in enumerate(result.motions, start=1)
            ),
            assumed_holds_n=result.assumed_holds_n,
            hold_contradicted=result.hold_contradicted,
            not_bounded=self._not_bounded(),
            setup_doubts=tuple(SetUpDoubtOut.of(item) for item in self.doubts),
            notices=self.notices,
            unfinished=None if result.recognition is None else unfinished_out(result.recognition),
            goal_met=result.goal_met,
            limit=result.limit,
            altered_probability=result.altered_probability,
            contradictions=tuple(_contradiction(item) for item in result.contradictions),
            narrower_without=self._narrower_without(),
            truth=truth and compare_answers(truth.placements, hypotheses, truth.at_measurement),
            parts=self._parts(),
            table=self._table(),
        )

    def _parts(self) -> tuple[PartOut, ...]:
        table, found = self.result.table, []
        for part, agreed in () if table is None else zip(table.parts, table.agreed, strict=True):
            one = replace(self, result=part).out(wall_seconds=0.0, session=None)
            truth = one.truth and one.truth.model_copy(update={"others": ()})
            found.append(PartOut.of(one, agreed=agreed, truth=truth))
        return tuple(found)

    def _table(self) -> TableOut | None:
        table = self.result.table
        if table is None:
            return None
        return TableOut(
            asked=str(self.job.parts),
            divisions=table.divisions,
            complete=table.is_complete,
            rest_radius=table.rest_mm,
            rest_heights=table.rest_z_mm,
        )

    def _alternatives(self, hypotheses: Sequence[Hypothesis]) -> tuple[AlternativeOut, ...]:
        if len(hypotheses) < 2 or self.result.recognition is None:
            return ()
        near = near_equal(self.result.recognition.hypotheses, goals_of(self.job.rig))[0].tolist()
        return tuple(
            _alternative(item, hypotheses[0], is_near=is_near)
            for item, is_near in zip(hypotheses[1:], near[1:], strict=True)
        )

    def _not_bounded(self) -> tuple[NotBoundedOut, ...]:
        """States of the answer in which the fingers may have tipped or rolled the part."""
        bounds = MotionBounds(self.job.rig, self.job.catalogue)
        pushed_n = max((bounds.peak_force_n(grip) for grip in self.result.grips), default=0.0)
        table = StabilityTable(self.job.rig, self.job.catalogue, bounds)
        return tuple(
            NotBoundedOut.of(item, object=item.object_name, state=item.state_name, when_pushed=item.response)
            for item in table.not_bounded(self.result.recognition, pushed_n)
        )

    def _narrower_without(self) -> tuple[WidthsWithoutOut, ...]:
        """Half-widths without each source of an answer's bounds, the narrowest by the goals first."""
        result, goals = self.result, goals_of(self.job.rig)
        if result.goal_met is None or result.recognition is None:
            return ()
        begin = result.moved_before[-1] - 1 if result.moved_before else 0
        grips = list(zip(result.grips, result.grip_motions, strict=True))[begin:]
        found = widths_by_source(self.job.rig, self.job.catalogue, result.recognition, grips)
        rows = [
            WidthsWithoutOut(source=source, position=half.position_mm, orientation=half.orientation_rad)
            for source, half in found.items()
        ]
        return tuple(
            sorted(
                rows,
                key=lambda row: row.position / goals.position_mm + row.orientation / goals.orientation_rad,
            )
        )


def _contradiction(item: Contradiction) -> ContradictionOut:
    return ContradictionOut(
        grip=item.grip,
        cause=item.cause,
        repeated_in=item.repeated_in,
        touches=item.touches,
        apart=item.apart_mm if math.isfinite(item.apart_mm) else None,
        hidden=item.hidden_mm if math.isfinite(item.hidden_mm) else None,
    )


def unfinished_out(recognition: Recognition) -> UnfinishedOut | None:
    """Part of the work that the budget did not suffice for; None if it did."""
    unpaired = tuple(contact.name for contact in recognition.unpaired_contacts)
    if not unpaired and not recognition.has_coarse_cells:
        return None
    return UnfinishedOut(
        budget=recognition.budget.units, unpaired=unpaired, coarse=recognition.has_coarse_cells
    )


def _touch_records(result: Identification) -> tuple[TouchRecordOut, ...]:
    """Records of what loaded the part in every touch, in the order of grips."""
    return tuple(
        TouchRecordOut(
            grip=number,
            finger=touch.contact.name,
            stage=load.stage.value,
            peak_force_n=load.peak_force_n,
            travel_in_contact_mm=load.travel_mm,
            work_mj=load.work_mj,
        )
        for number, grip in enumerate(result.grips, start=1)
        for touch in grip
        for load in touch.loads
    )


def state_names(item: Hypothesis) -> dict[str, object]:
    """The names of a hypothesis's object and state, as results have them."""
    return {"object": item.state.object_name, "state": item.state.state.name}


def _alternative(item: Hypothesis, first: Hypothesis, *, is_near: bool) -> AlternativeOut:
    same = item.state_index == first.state_index
    turned, moved = _displacement(first, item) if same else (None, None)
    other = Relation.NEAR if is_near else Relation.TWIN
    return AlternativeOut.of(
        item,
        **state_names(item),
        relation=Relation.SYMMETRY if same else other,
        turned=turned,
        moved=moved,
    )


def _displacement(first: Hypothesis, other: Hypothesis) -> tuple[float, float]:
    """Displacement from one configuration of a state to another: angle (rad), way of its centre of area (mm).

    Of the turns that the state's symmetry makes equal, the smallest; 0 of a round one.
    """
    if first.state.state.is_round:
        return 0.0, math.dist(_centre(first), _centre(other))
    turn = 2 * math.pi / first.state.symmetry.order
    turned = other.configuration.theta_rad - first.configuration.theta_rad
    turned -= turn * round(turned / turn)
    return turned, math.dist(_centre(first), _centre(other))


def _centre(item: Hypothesis) -> tuple[float, float]:
    """Centre of area in W."""
    at, (u, v) = item.configuration, item.state.origin_mm.tolist()
    cos, sin = math.cos(at.theta_rad), math.sin(at.theta_rad)
    return at.x_mm + cos * u - sin * v, at.y_mm + sin * u + cos * v


def hypotheses_of(result: Identification) -> Sequence[Hypothesis]:
    """Hypotheses of the last recognition, the heaviest first; none if nothing was touched."""
    return () if result.recognition is None else result.recognition.hypotheses
