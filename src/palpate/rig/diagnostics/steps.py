"""Steps of a diagnosis: the case that is examined, and how steps and findings are made."""

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from palpate.config import RigFile
from palpate.config.diagnosis_results import Cause, DoctorStepOut, FindingOut, Outcome, Severity
from palpate.rig.calibrated_rig import RigOnBench
from palpate.rig.diagnostics.host_ports import Computer
from palpate.rig.diagnostics.servo_bus import BusEndpoint
from palpate.rig.pads import has_pads

NOTHING_TO_DO = "nothing"
"""How the next thing to do begins where there is none."""

_MAX_LISTED = 6


@dataclass(frozen=True, eq=False)
class DiagnosisCase:
    """What is examined: a rig, where its ports are, the computer; `tell` hears what is looked at now."""

    on_bench: RigOnBench
    place: BusEndpoint
    computer: Computer
    tell: Callable[[str], None] = lambda _: None

    @property
    def rig(self) -> RigFile:
        """The rig with its calibration laid over it."""
        return self.on_bench.rig

    def command(self, words: str) -> str:
        """A command of palpate as the user would type it, with this rig's file in the place of RIG."""
        return words.replace("RIG", shlex.quote(str(self.on_bench.path)))

    def calibrate_or(self, by_hand: str) -> str:
        """The command that calibrates this rig; what to do `by_hand` if it has pads."""
        return by_hand if has_pads(self.rig) else self.command("palpate calibrate --rig RIG")


def finish_step(name: str, looked_at: str, saw: str, findings: Sequence[FindingOut] = ()) -> DoctorStepOut:
    """A step that was carried out."""
    worst = {item.severity for item in findings}
    outcome = (
        Outcome.WRONG
        if Severity.WRONG in worst
        else Outcome.WARNING
        if Severity.WARNING in worst
        else Outcome.WELL
    )
    return DoctorStepOut(step=name, outcome=outcome, looked_at=looked_at, saw=saw, findings=tuple(findings))


def skip_step(name: str, looked_at: str, because: str) -> DoctorStepOut:
    """A step that was not carried out."""
    return DoctorStepOut(
        step=name, outcome=Outcome.SKIPPED, looked_at=looked_at, saw="", skipped_because=because
    )


def error_finding(cause: Cause, device: str, saw: str, means: str, do: str) -> FindingOut:
    """A finding with which the rig cannot be worked."""
    return FindingOut(cause=cause, severity=Severity.WRONG, device=device, saw=saw, means=means, next=do)


def warning_finding(cause: Cause, device: str, saw: str, means: str, do: str) -> FindingOut:
    """A finding with which it can."""
    return FindingOut(cause=cause, severity=Severity.WARNING, device=device, saw=saw, means=means, next=do)


def join_words(items: Sequence[str], most: int = _MAX_LISTED) -> str:
    """Some items in words: "a, b and c"; of more than `most` the first ones, and how many there are."""
    if len(items) > most:
        return f"{', '.join(items[:most])} and {len(items) - most} more"
    return " and ".join(filter(None, (", ".join(items[:-1]), items[-1]))) if items else "none"
