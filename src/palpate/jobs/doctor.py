"""Doctor from Python: a set-up examined step by step, and a report on it for a bug tracker."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from palpate.base.errors import InputError
from palpate.config.doctor_result import DoctorOut, DoctorStepOut, FindingOut
from palpate.config.results import to_json
from palpate.rig.bench import BenchRig, environment, set_up
from palpate.rig.calibrated_rig import RigOnBench
from palpate.rig.diagnostics.bus_selection import BusEndpoint, endpoint_of_rig
from palpate.rig.diagnostics.computer import Computer
from palpate.rig.diagnostics.doctor import diagnose
from palpate.rig.diagnostics.doctor_directions import EmulatedOnlooker, Onlooker, examine_directions
from palpate.rig.diagnostics.doctor_steps import Case
from palpate.views.doctor_report import doctor_report

__all__ = ["DoctorAnswer", "examine_rig"]


@dataclass(frozen=True, eq=False, repr=False)
class DoctorAnswer:
    """What `Rig.doctor` found (`palpate/doctor@1`)."""

    result: DoctorOut
    on_bench: RigOnBench

    @property
    def well(self) -> bool:
        """Whether nothing is wrong; there may be warnings."""
        return self.result.well

    @property
    def steps(self) -> Sequence[DoctorStepOut]:
        """All steps, in the order in which things go wrong."""
        return self.result.steps

    @property
    def findings(self) -> Sequence[FindingOut]:
        """What is not as it should be: cause, device, what was seen, what it means, what to do next."""
        return self.result.findings

    def to_json(self) -> str:
        """`palpate/doctor@1`."""
        return to_json(self.result)

    def report(self) -> str:
        """A report for a bug tracker, in Markdown: versions, steps and the rig file's relevant parts.

        Names of users, computers and folders are left out, serial numbers are hashed.
        """
        return doctor_report(self.result, self.on_bench.described)

    def __repr__(self) -> str:
        verdict = "well" if self.well else "NOT well"
        return f"<DoctorAnswer {self.result.rig}: {verdict}; {self.result.next or 'nothing to do'}>"


def examine_rig(
    on_bench: RigOnBench,
    seed: int,
    *,
    move: bool,
    onlooker: Onlooker | None,
    permit: Callable[[], None],
    progress: Callable[[str], None],
    notice: Callable[[str], None],
) -> DoctorAnswer:
    """Examine; arguments and errors as `Rig.doctor`."""
    if move and onlooker is None and not on_bench.rig.emulated:
        raise InputError(f'rig "{on_bench.rig.name}" is real: give an onlooker, who says which way tips go')
    place = endpoint_of_rig(on_bench.described, seed)
    case = Case(on_bench, place, Computer(), progress)

    def directions() -> DoctorStepOut:
        bench = _bench(place, on_bench)
        watching = onlooker or EmulatedOnlooker(bench)
        permit()
        with environment(bench).hand(on_bench.rig, notice) as hand:
            return examine_directions(hand, watching)

    return DoctorAnswer(diagnose(case, datetime.now(UTC), directions if move else None), on_bench)


def _bench(place: BusEndpoint, on_bench: RigOnBench) -> BenchRig:
    """The devices that were examined: emulated ones are those of `place`."""
    return place.devices if isinstance(place.devices, BenchRig) else set_up(on_bench.described, None, 0)
