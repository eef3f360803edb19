"""Sessions on a calibrated rig: one that has changed a little is noticed, one that has not is not."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from command import Ended, log_lines, run_here, write_log
from felt_patch import felt_patch
from firm_rig import firm_rig
from json_schema import violations
from quick_rig import STAGE, quick_rig
from shapely_bench import SHIPPED_OBJECTS, outlines, place_within
from simulated_touches import SimulatedTouches
from truth_calibration import MADE, bench_calibration, truth_calibration
from wording import missing

from palpate.base.vocabulary import IdentificationVerdict, Strategy
from palpate.config import (
    CalibrationFile,
    RigFile,
    StageConfig,
    apply_calibration,
    calibration_path,
    calibration_toml,
    load_rig,
)
from palpate.config.identification_result import CalibrationUsedOut, IdentificationOut
from palpate.config.schema import schema_text
from palpate.drivers.tactile.patches import PatchFlag
from palpate.recognizer import Catalogue, FingerApproach
from palpate.rig.emulated.devices import emulate
from palpate.rig.identification.loop import Identification, search
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import Reach, reach_of
from palpate.rig.session.calibration_drift import calibration_used, session_agreement
from palpate.views.answer import answer_lines

Here = Callable[..., Ended]
RIG = load_rig(firm_rig())
SIX = outlines(SHIPPED_OBJECTS)
CATALOGUE = Catalogue(SIX)
SEEDS = range(4)
BOUND_MM, ERROR_MM = 0.25, 0.02


@dataclass
class Felt:
    """Touches that are `ERROR_MM` off at most, of a rig on which one finger's base is elsewhere."""

    touches: SimulatedTouches
    off_mm: tuple[float, float]

    def __call__(self, grip: Sequence[FingerApproach], tell: Callable[[GripPhase], None]) -> list[Touch]:
        del tell
        return [self._declared(touch) for touch in self.touches(grip)]

    def _declared(self, touch: Touch) -> Touch:
        dx, dy = self.off_mm if touch.finger_index == 1 else (0.0, 0.0)
        (x, y), (u, v) = touch.contact.start_mm, touch.contact.end_mm
        contact = replace(
            touch.contact,
            start_mm=(x + dx, y + dy),
            end_mm=(u + dx, v + dy),
            position_bound_mm=BOUND_MM,
            path_bound_mm=BOUND_MM + 0.3,
        )
        return replace(touch, contact=contact, patch=felt_patch() if contact.touched else None)


@pytest.fixture(scope="module")
def file() -> CalibrationFile:
    return truth_calibration(RIG, emulate(RIG, None, 0).bench.fingers)


@pytest.fixture(scope="module")
def rig(file: CalibrationFile) -> RigFile:
    return apply_calibration(RIG, file)


@pytest.fixture(scope="module")
def reach(rig: RigFile) -> Reach:
    return reach_of(rig)


def session(
    rig: RigFile, reach: Reach, seed: int, off_mm: tuple[float, float] = (0.0, 0.0)
) -> Identification:
    """A whole search for a part that the seed draws."""
    rng = np.random.default_rng([seed, 0])
    placed = place_within(SIX[int(rng.integers(len(SIX)))], rng)
    touches = SimulatedTouches(reach, placed, np.random.default_rng([seed, 5]))
    touches.share = ERROR_MM / reach.approaches[0].position_bound_mm
    return search(rig, reach, Felt(touches, off_mm), CATALOGUE, seed=seed)


def test_a_rig_that_is_as_it_was_is_not_said_to_have_changed(
    file: CalibrationFile, rig: RigFile, reach: Reach
) -> None:
    identified = 0
    for seed in SEEDS:
        found = session_agreement(session(rig, reach, seed), rig, file)
        if found is not None:
            identified += 1
            assert not found.drifted, seed
            assert found.rms_mm < 0.03
    assert identified >= 3


def test_a_finger_that_moved_within_its_bound_is_mostly_noticed(
    file: CalibrationFile, rig: RigFile, reach: Reach
) -> None:
    noticed = identified = 0
    for seed in SEEDS:
        result = session(rig, reach, seed, (0.13, 0.075))
        found = session_agreement(result, rig, file)
        if result.outcome is IdentificationVerdict.IDENTIFIED:
            assert found is not None
            identified += 1
            noticed += found.drifted
    assert identified >= 3
    assert noticed >= 0.6 * identified, (noticed, identified)


def test_what_is_said_of_a_session(file: CalibrationFile, rig: RigFile, reach: Reach) -> None:
    result = session(rig, reach, 0)
    used = calibration_used(result, rig, file, MADE + timedelta(days=12, hours=3))
    assert (used.made, used.age_days, used.drifted) == ("2026-05-04T12:30:00Z", 12, False)
    assert calibration_used(result, rig, file, MADE - timedelta(days=1)).age_days == 0
    assert session_agreement(result, rig, None) is None
    bare = file.model_copy(update={"residuals": None})
    assert calibration_used(result, rig, bare, MADE).drifted is None
    assert session_agreement(replace(result, recognition=None), rig, file) is None


def test_touches_that_do_not_count_are_left_out(file: CalibrationFile, rig: RigFile, reach: Reach) -> None:
    """Which way a tip is dented by two edges at once is not known; before a shift, the part lay elsewhere."""
    results = (session(rig, reach, seed) for seed in range(30))
    result = next(item for item in results if len(item.grips) >= 3 and item.touches >= 8)
    wide = felt_patch(flags=frozenset({PatchFlag.WIDE}))
    first = [replace(touch, patch=touch.patch and wide) for touch in result.grips[0]]
    others = replace(result, grips=(tuple(first), *result.grips[1:]))
    later = replace(result, moved_before=(2,))
    counts = []
    for item in (result, others, later):
        found = session_agreement(item, rig, file)
        assert found is not None
        counts.append(len(found.residual_mm))
    touched = sum(touch.patch is not None for touch in result.grips[0])
    assert counts == [counts[0], counts[0] - touched, counts[0] - touched]


def ended(verdict: IdentificationVerdict, drifted: bool | None) -> IdentificationOut:
    used = CalibrationUsedOut(
        made="2026-05-04T12:30:00Z",
        age_days=12,
        residual_rms_mm=0.0812,
        expected_rms_mm=0.0204,
        drifted=drifted,
    )
    return IdentificationOut(
        verdict=verdict,
        object=None if verdict is IdentificationVerdict.UNKNOWN else "plate",
        state=None if verdict is IdentificationVerdict.UNKNOWN else "flat",
        configuration=None,
        bounds=None,
        alternatives=(),
        symmetry_order=1,
        strategy=Strategy.PLANNED,
        grips=2,
        touches=5,
        predicted=0,
        moved_before=(),
        detectable_shift=None,
        emulated=True,
        rig_seconds=1.0,
        wall_seconds=1.0,
        session=None,
        calibration=used,
    )


def test_the_answer_says_so() -> None:
    advice = ("rig", "changed", "calibration of 2026-05-04", "`palpate check --touch`")
    drifted = "\n".join(answer_lines(ended(IdentificationVerdict.IDENTIFIED, drifted=True)))
    assert missing(drifted, "0.081 mm", "0.020", *advice) == []
    steady = "\n".join(answer_lines(ended(IdentificationVerdict.IDENTIFIED, drifted=False)))
    assert "palpate check --touch" not in steady
    unknown = "\n".join(answer_lines(ended(IdentificationVerdict.UNKNOWN, drifted=None)))
    assert missing(unknown, "unknown: ", *advice) == []


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Here:
    monkeypatch.chdir(tmp_path)
    return lambda *args: run_here(args, monkeypatch, capsys)


def test_the_age_counts_from_the_start_of_the_session(here: Here) -> None:
    """So that a replay, whenever it is made, says the same."""
    path = quick_rig(Path("rig.toml"), max_grips=1)
    made = datetime.now(UTC).replace(microsecond=0) - timedelta(days=40)
    file = bench_calibration(load_rig(path), 3).model_copy(update={"made": made})
    calibration_path(path).write_text(calibration_toml(file))
    done = here("identify", "--rig", path, "--seed", 3, "--json")
    assert violations(done.json, json.loads(schema_text("identification"))) == []
    used = done.json["calibration"]
    assert (used["age_days"], used["made"]) == (40, made.isoformat().replace("+00:00", "Z"))
    folder = Path(done.json["session"])
    again = here("replay", folder)
    assert (again.code, again.err) == (0, "")

    log = folder / "session.jsonl.zst"
    first, *rest = log_lines(log)
    header = json.loads(first) | {"started": "some day"}
    write_log(log, [json.dumps(header) + "\n", *rest])
    assert '"started" must be a date and time in UTC' in here("replay", folder).err


def test_what_a_stage_puts_contacts_off_by_is_no_change_of_the_rig(
    file: CalibrationFile, rig: RigFile, reach: Reach
) -> None:
    """Every other grip at another angle, its contacts turned by as much as the rig file allows of a stage."""
    result, off_rad = session(rig, reach, 0), math.radians(0.3)
    stage = StageConfig(**STAGE | {"bound_deg": 0.3})
    c, s = math.cos(off_rad), math.sin(off_rad)

    def turned(touch: Touch) -> Touch:
        x, y = np.array(touch.contact.end_mm) - stage.centre_mm
        end = (stage.centre_mm[0] + c * x - s * y, stage.centre_mm[1] + s * x + c * y)
        return replace(touch, contact=replace(touch.contact, end_mm=end), stage_rad=0.3)

    grips = [[turned(item) if k % 2 else item for item in grip] for k, grip in enumerate(result.grips)]
    again = replace(result, grips=grips)
    without = session_agreement(again, rig, file)
    staged = session_agreement(again, rig.model_copy(update={"stage": stage}), file)
    assert without is not None
    assert without.drifted
    assert staged is not None
    assert not staged.drifted
