"""What arrays show in a run that is not as declared is noted beside its answer, and nothing else is."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from palpate.base.errors import DeviceError, PalpateError
from palpate.config import RigFile
from palpate.drivers.emulators import Taxels
from palpate.drivers.tactile import Description, Shape
from palpate.recognizer import Catalogue
from palpate.rig.identification.events import Observers
from palpate.rig.identification.identify import identify
from palpate.rig.identification.result import Identification
from support.benches.rigs import small_objects, small_rig
from support.benches.session import EmulatedSession, connect, emulated_session
from support.campaign.sampling import sample
from support.devices.spoilt_taxels import (
    Spoil,
    drift,
    drop_rows,
    gain,
    interference,
    loose,
    low_pass,
    spoil,
)

_OBJECTS = small_objects()


@dataclass
class _Run:
    """A run, and what was noted in it."""

    session: EmulatedSession
    noted: list[str] = field(default_factory=list)
    result: Identification | None = None
    error: PalpateError | None = None

    def of(self, finger: str) -> list[str]:
        return [line for line in self.noted if line.startswith(f"tactile array {finger} ")]


def _run(
    *spoils: Spoil | None, grips: int = 1, seed: int = 7, lag_s: float = 0.0, emulated_lag_s: float = 0.0
) -> _Run:
    """A run of few grips on a small bench whose arrays are spoilt in the order of its fingers."""
    data = small_rig().model_dump(mode="json", exclude_none=True)
    data["search"]["max_grips"] = grips
    data["emulation"]["lag_s"] = emulated_lag_s
    for finger in data["fingers"]:
        finger["array"]["lag_s"] = lag_s
    session = emulated_session(seed=seed, rig=RigFile.model_validate(data), objects=_OBJECTS)
    for finger, how in zip(session.bench.fingers, spoils, strict=False):
        if how is not None:
            spoil(finger.array, how)
    run = _Run(session)
    try:
        with connect(session.bench_rig) as hand:
            hand.prepare()
            run.noted = hand.checks.noted
            run.result = identify(hand, Catalogue(_OBJECTS.objects), Observers(), seed=1)
    except PalpateError as error:
        run.error = error
    assert not any(session.torque().values())
    return run


@pytest.mark.parametrize("lag_s", sample([0.0, 0.1], [0.1]))
def test_right_arrays_are_silent(lag_s: float) -> None:
    run = _run(lag_s=lag_s, emulated_lag_s=lag_s)
    assert run.error is None
    assert run.noted == []


def test_each_array_is_named_with_what_it_shows() -> None:
    run = _run(None, drift(1.0), low_pass(0.1))
    assert run.error is None
    assert run.of("f1") == []
    (zero,), (slow,) = (run.of(name) for name in ("f2", "f3"))
    assert "does not come back to its zero" in zero
    assert "lag_s" in slow


def test_interference_rows_and_gains_are_named() -> None:
    run = _run(interference(40.0), drop_rows(0.05), gain(0.5, from_s=2.0), grips=2)
    assert "interference" in run.of("f1")[0]
    assert "whole rows" in run.of("f2")[0]
    assert run.of("f3")


def test_a_loose_wire_is_the_cause_that_is_given() -> None:
    error = _run(loose(0.3)).error
    assert isinstance(error, DeviceError)
    assert "row 2, column 3" in str(error)


def test_zeros_that_have_fallen_away_are_no_silence() -> None:
    run = _run(drift(-8.0), grips=3)
    assert run.of("f1")
    assert run.error is not None
    assert any(line in run.error.__notes__ for line in run.of("f1"))


def test_the_emulated_filter_shows_a_step_after_its_time() -> None:
    described = Description(
        bytes(16), "", True, Shape.FLAT, 1, 2, 12, 1000.0, 2.0, 2000.0, 0.0, (0.0, 1.0), (0.5,)
    )
    taxels = Taxels(described, seed=1, noise_counts=0.0, lag_s=0.2)
    times = np.arange(0.004, 0.5, 0.004)
    shown = [taxels.counts(np.full((1, 2), 1.0 if t > 0.1 else 0.0), float(t))[0, 0] for t in times]
    after = np.array(shown)[times > 0.1 + 0.2]
    assert abs(int(after[0]) - 1980) < 10
    assert after[-1] > 1995
