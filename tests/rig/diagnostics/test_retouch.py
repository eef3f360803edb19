"""A disc touched again: it agrees with a right calibration, and not with one of a rig that has changed."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from command import Ended, run_here
from firm_rig import firm_rig
from json_schema import violations
from quick_rig import quick_rig
from rich.console import Console
from simulated_prober import SimulatedProber, SimulatedRig
from truth_calibration import bench_calibration, truth_calibration

from palpate.base.errors import InputError
from palpate.calibration.drift_test import contact_uncertainties
from palpate.calibration.measurements import Probe, TouchMeasurement
from palpate.calibration.reference import Reference, ReferenceDisc
from palpate.config import apply_calibration, calibration_path, calibration_toml, load_rig
from palpate.config.diagnosis_results import (
    AdapterCheckOut,
    BusCountsOut,
    CalibrationCheckOut,
    CheckOut,
    TouchForceOut,
)
from palpate.config.schema import schema_text
from palpate.rig.diagnostics.calibration_check import Retouch, retouch, with_touch
from palpate.views.check_table import show_check

RIG = load_rig(firm_rig())
DISC = ReferenceDisc("disc", 25.0)
Here = Callable[..., Ended]
CHECKED = CheckOut(
    rig="bench",
    emulated=True,
    well=True,
    adapter=AdapterCheckOut(port="mock://bus", baudrate_bps=1000000, latency_timer_ms=None),
    servos=(),
    arrays=(),
    loop=None,
    bus=BusCountsOut(instructions=1, silent=0, damaged=0, retries=0, alerts=0, reconnects=0, stale=0),
    touch_force=TouchForceOut(quick_n=2.8, slow_n=0.5, unstopped_n=15.5),
    calibration=CalibrationCheckOut(
        file="rig.calibration.toml",
        made="2026-05-04T12:30:00Z",
        age_days=3,
        coverage=0.999,
        position_mm=0.2,
        direction_deg=0.5,
        devices_match=True,
    ),
    problems=(),
    warnings=(),
)


def touched(
    seed: int,
    off_mm: dict[str, tuple[float, float]] | None = None,
    disc: ReferenceDisc = DISC,
    spoil: Callable[[Reference, int], Reference] = lambda item, _: item,
) -> Retouch:
    """A re-touch of a simulated rig whose calibration has bases of fingers off by so much."""
    world = SimulatedRig(RIG, seed, spoil)
    file = truth_calibration(RIG, world.fingers, off_mm=off_mm)
    uncertainties = contact_uncertainties(file, at_rest=False)
    assert uncertainties is not None
    rig = apply_calibration(RIG, file)
    with world.connect(rig, moving=True) as there:
        return retouch(rig, there.prober, disc, uncertainties)


def test_a_rig_that_is_as_it_was_agrees() -> None:
    for seed in range(5):
        found = touched(seed)
        assert not found.agreement.drifted, seed
        assert [item.touches for item in found.fingers] == [5, 5, 5]
        assert max(abs(item.offset_mm) for item in found.fingers) < 0.03


@pytest.mark.parametrize("off", [(1.0, 0.0), (0.0, -1.0), (0.6, 0.8)])
def test_a_finger_that_moved_by_a_millimetre_does_not(off: tuple[float, float]) -> None:
    found = touched(1, {"f2": off})
    assert found.agreement.drifted
    assert found.agreement.rms_mm > 5 * found.agreement.expected_rms_mm


def test_a_finger_that_moved_by_little_is_mostly_noticed() -> None:
    assert sum(touched(seed, {"f2": (0.13, 0.075)}).agreement.drifted for seed in range(4)) >= 3


def test_another_disc_than_said_does_not_agree_unless_its_tolerance_explains_it() -> None:
    def larger(item: Reference, _: int) -> Reference:
        assert isinstance(item, ReferenceDisc)
        return replace(item, radius_mm=item.radius_mm + 0.15)

    assert touched(0, spoil=larger).agreement.drifted
    assert not touched(0, disc=replace(DISC, tolerance_mm=0.2), spoil=larger).agreement.drifted


class Empty(SimulatedProber):
    """Of a table with nothing on it."""

    def touch(self, grip: Sequence[Probe], placing: int) -> list[TouchMeasurement | None]:
        del placing
        return [None for _ in grip]


def test_no_disc_is_said() -> None:
    world = SimulatedRig(RIG, 0)
    uncertainties = contact_uncertainties(truth_calibration(RIG, world.fingers), at_rest=False)
    assert uncertainties is not None
    with pytest.raises(InputError, match=r"the disc was not found near \(0, 0\) mm"):
        retouch(RIG, Empty(world, RIG), DISC, uncertainties)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Here:
    monkeypatch.chdir(tmp_path)
    return lambda *args: run_here(args, monkeypatch, capsys)


def test_check_touches_a_disc(here: Here, tmp_path: Path) -> None:
    rig = quick_rig(tmp_path / "rig.toml")
    none = here("check", "--touch", "--rig", rig, "--yes")
    assert (none.code, none.out) == (2, "")
    assert f"make it with `palpate calibrate --rig {rig}`" in none.err
    calibration_path(rig).write_text(calibration_toml(bench_calibration(load_rig(rig), 3)))

    other = here("check", "--touch", "--rig", rig, "--seed", 4, "--yes", "--json")
    assert other.code == 3
    assert "nothing was touched: first put right what is wrong" in other.json["warnings"]
    assert other.json["calibration"]["touch"] is None

    done = here("check", "--touch", "--rig", rig, "--seed", 3, "--yes", "--json")
    assert done.code == 0, done.err
    assert violations(done.json, json.loads(schema_text("check"))) == []
    touch = done.json["calibration"]["touch"]
    assert touch["agrees"]
    assert [item["touches"] for item in touch["fingers"]] == [5, 5]
    assert touch["residual_rms_mm"] < 0.03
    assert [0.02 < item["friction_a"] < 0.04 for item in touch["fingers"]] == [True, True]
    assert "agrees with 10 touches (f1 " in done.err
    assert "; slides need 0.0" in done.err


def test_nobody_moves_fingers_unasked(here: Here, tmp_path: Path) -> None:
    rig = quick_rig(tmp_path / "rig.toml")
    calibration_path(rig).write_text(calibration_toml(bench_calibration(load_rig(rig), 0)))
    unasked = here("check", "--touch", "--rig", rig)
    assert (unasked.code, unasked.out) == (2, "")
    assert "say --yes if they may" in unasked.err


def test_a_rig_that_does_not_agree_is_not_well(capsys: pytest.CaptureFixture[str]) -> None:
    out = with_touch(CHECKED, touched(0, {"f2": (1.0, 0.0)}), RIG)
    assert not out.well
    (problem,) = out.problems
    assert problem.startswith("touches of the disc differ by 0.")
    assert "mm (in the mean f1 " in problem
    assert "calibrate again, unless the disc moved or is not as given" in problem
    show_check(out, Console(width=200, soft_wrap=True))
    assert "does not agree with 15 touches (f1 " in capsys.readouterr().out
    assert with_touch(CHECKED, touched(0), RIG).well
