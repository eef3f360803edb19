"""Contact sources on a rig: true touches, faults, what is refused, recorded and replayed."""

import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate
from palpate.base.errors import DeviceError, InputError, PalpateError
from palpate.config import ArrayConfig, RigFile, load_rig
from palpate.config.rig_file import change_tables
from palpate.drivers.emulators import EmulatedContactSource
from palpate.drivers.tactile import ContactReading
from palpate.drivers.transport import MonotonicClock, open_port
from palpate.rig.arrays import array_plugin
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.testing import FreeRunningConformance, RigConformance
from palpate.testing.conformance import ArrayBench
from support.benches.rigs import small_objects, small_rig
from support.benches.session import EmulatedSession, emulated_session, run_checked
from support.campaign.sampling import sample
from support.commands.repository import EXAMPLES, ROOT

CONTACT_RIG = EXAMPLES / "contact-rig.toml"


class TestContactLines(FreeRunningConformance):
    protocol = "contact-lines"
    keys = {"rate_hz": 25.0}
    shape = (1, 1)
    pressed = (0, 0)


class TestSharedConnection(FreeRunningConformance):
    protocol = "contact-lines"
    keys = {"rate_hz": 25.0, "source": "left", "checksum": True}
    shape = (1, 1)
    pressed = (0, 0)


class TestBench(RigConformance):
    """The runs of docs/contact-lines.md."""

    rig = CONTACT_RIG
    seeds = tuple(range(100, 124))


def test_any_program_can_read_its_lines() -> None:
    bench = ArrayBench("contact-lines", {"rate_hz": 50.0, "source": "left"})
    program = (
        "import json, serial, sys\n"
        "with serial.Serial(sys.argv[1], 1000000, timeout=2) as port:\n"
        "    port.readline()\n"
        "    lines = [json.loads(port.readline().split(b'*')[0]) for _ in range(20)]\n"
        "print(json.dumps(lines))\n"
    )
    lines, _ = bench.read_by(program)
    assert {line["finger"] for line in lines} == {"left"}
    true_n = float(bench.force_n.sum())
    assert all(abs(line["force_n"] - true_n) <= line["force_bound_n"] for line in lines)


def session_of(seed: int = 7, **array: object) -> EmulatedSession:
    rig = small_rig(CONTACT_RIG)
    if array:
        rig = change_tables(rig, {"fingers": {each.name: {"array": array} for each in rig.fingers}}, "test")
    return emulated_session(seed=seed, rig=rig, objects=small_objects())


def source_of(session: EmulatedSession, finger: int = 0) -> EmulatedContactSource:
    array = session.bench.fingers[finger].array
    assert isinstance(array, EmulatedContactSource)
    return array


@pytest.mark.slow
@pytest.mark.parametrize("seed", sample(range(3), [2]))
def test_every_touch_is_true_of_the_bench(seed: int) -> None:
    touches = run_checked(session_of(seed), 4, seed)
    found = [touch.patch for touch in touches if touch.patch is not None]
    assert len(found) > 4
    assert all(patch.angle_half_range_rad < math.pi for patch in found)


@pytest.mark.slow
def test_touches_without_normals_are_true_too() -> None:
    session = session_of(3)
    for finger in range(3):
        source_of(session, finger).spoil = lambda reading: reading._replace(angle_rad=math.nan)
    touches = run_checked(session, 1, 3)
    found = [touch for touch in touches if touch.patch is not None]
    assert found
    assert all(touch.contact.normal is None for touch in found)


@pytest.mark.slow
def test_no_reading_is_trusted_beyond_the_rig_file() -> None:
    touches = run_checked(session_of(3, angle_bound_deg=20.0, force_bound_n=0.2), 1, 3)
    for touch in touches:
        if touch.patch is not None:
            assert touch.patch.angle_half_range_rad >= math.radians(20.0) - 1e-9
            assert touch.patch.force_bound_n >= 0.2 - 1e-9


# ----------------------------------------------------------------------------------------------------
# Faults: one line that names the finger and what was seen, and torque off.


@dataclass
class Backwards:
    """A clock that goes backwards from its first reading on."""

    begun_s: float | None = None

    def __call__(self, reading: ContactReading) -> ContactReading:
        at_s = reading.time_s or 0.0
        self.begun_s = at_s if self.begun_s is None else self.begun_s
        return reading._replace(time_s=100.0 + self.begun_s - at_s, time_bound_s=0.0)


FAULTS: dict[str, tuple[Callable[[ContactReading], ContactReading | None], str]] = {
    "silent": (lambda _: None, "nothing"),
    "bound of nan": (lambda reading: reading._replace(force_bound_n=math.nan), "force_bound_n"),
    "bound of inf": (lambda reading: reading._replace(force_bound_n=math.inf), "force_bound_n"),
    "bound below 0": (lambda reading: reading._replace(force_bound_n=-0.1), "force_bound_n"),
    "pulls": (lambda reading: reading._replace(force_n=-1.0), "force_n"),
}


def check_off(session: EmulatedSession) -> None:
    assert not any(session.torque().values())
    assert session.rest(0.5) < 4.0
    assert session.rest(0.5) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", sample(FAULTS, ["silent", "bound below 0"]))
def test_a_source_that_fails_in_motion_is_named_and_torque_goes_off(name: str, tmp_path: Path) -> None:
    session = session_of()
    spoil, seen = FAULTS[name]

    def on_stage(now: GripPhase) -> None:
        if now is GripPhase.CLOSING:
            session.clock.after(0.5, lambda: setattr(source_of(session, 1), "spoil", spoil))

    with pytest.raises(DeviceError) as caught:
        session.run_grip(tmp_path, session.middle(), on_stage)
    message = str(caught.value)
    assert "\n" not in message
    assert "f2" in message
    assert seen in message
    check_off(session)


@pytest.mark.slow
def test_time_that_runs_backwards_is_named_and_torque_goes_off(tmp_path: Path) -> None:
    session = session_of(_seed_that_stamps(1))

    def on_stage(now: GripPhase) -> None:
        if now is GripPhase.CLOSING:
            session.clock.after(0.5, lambda: setattr(source_of(session, 1), "spoil", Backwards()))

    with pytest.raises(DeviceError) as caught:
        session.run_grip(tmp_path, session.middle(), on_stage)
    assert "f2" in str(caught.value)
    assert "t_s" in str(caught.value)
    check_off(session)


def _seed_that_stamps(finger: int) -> int:
    nothing = np.zeros((8, 180))
    return next(
        seed
        for seed in range(20)
        if source_of(session_of(seed), finger).reading(0.0, nothing).time_s is not None
    )


def test_a_force_before_anything_touches_is_named_and_nothing_moves(tmp_path: Path) -> None:
    session = session_of()
    source_of(session, 2).spoil = lambda reading: reading._replace(force_n=reading.force_n + 0.8)
    with pytest.raises(DeviceError) as caught:
        session.run_grip(tmp_path, session.middle())
    assert "f3" in str(caught.value)
    assert "nothing should touch" in str(caught.value)
    check_off(session)


# ----------------------------------------------------------------------------------------------------
# What is refused, diagnosed, recorded and replayed.


@pytest.fixture(scope="module")
def rig() -> RigFile:
    return load_rig(CONTACT_RIG)


@pytest.mark.parametrize("ability", ["calibrate", "simulate", "check what parts hold"])
def test_what_needs_taxels_or_a_calibration_is_refused(rig: RigFile, ability: Any) -> None:
    with pytest.raises(InputError, match="finger f1"):
        rig.require(ability)
    rig.require("identify")


@pytest.mark.parametrize(
    "wrong",
    [
        {"first_texel": "upper-left"},
        {"drift_counts_per_s": 1.0},
        {"force_bound_n": -1.0},
        {"angle_bound_deg": 200.0},
        {"rate_hz": None},
    ],
)
def test_keys_that_do_not_belong_to_a_source_are_refused(rig: RigFile, wrong: dict[str, object]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        change_tables(rig, {"fingers": {"f1": {"array": wrong}}}, "test")


def test_a_threshold_below_its_bounds_is_refused_by_doctor_and_by_a_run(rig: RigFile, tmp_path: Path) -> None:
    file = tmp_path / "blunt.toml"
    text = CONTACT_RIG.read_text(encoding="utf-8")
    file.write_text(text.replace("force_bound_n = 0.03", "force_bound_n = 0.6"), encoding="utf-8")
    with palpate.open_rig(file, seed=7) as opened:
        wrong = [item for item in opened.doctor().findings if item.severity == "wrong"]
        assert {item.cause for item in wrong} == {"noise"}
        with pytest.raises(PalpateError, match=r"f1.*contact_force_n"):
            opened.identify(sessions=tmp_path)


@pytest.mark.slow
def test_a_run_is_recorded_and_replayed_to_the_same_result(tmp_path: Path) -> None:
    file = tmp_path / "brief.toml"
    text = CONTACT_RIG.read_text(encoding="utf-8")
    file.write_text(text.replace("max_grips = 12", "max_grips = 1"), encoding="utf-8")
    with palpate.open_rig(file, seed=7) as opened:
        answer = opened.identify(sessions=tmp_path)
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir())
    replayed = palpate.open_session(folder).replay()
    assert replayed.difference is None
    assert replayed.complete
    assert replayed.run is not None
    again = tuple(tuple(touch.contact for touch in grip) for grip in replayed.run.result.grips)
    assert again == answer.grips


@pytest.mark.realtime
def test_the_program_of_the_page_is_read_on_a_pseudo_terminal() -> None:
    page = (ROOT / "docs" / "contact-lines.md").read_text(encoding="utf-8")
    program = page.split("```python\n")[1].split("```")[0]
    sense = "import math\nsense = lambda: (0.25, -30.0)\n"
    unbuffered = [sys.executable, "-u", "-c", sense + program]
    with subprocess.Popen(unbuffered, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        url = running.stdout.readline().split(" = ")[1].strip()
        config = ArrayConfig.model_validate(
            {"port": url, "baudrate_bps": 115200, "protocol": "contact-lines", "rate_hz": 45.0}
        )
        with open_port(url, 115200) as port:
            array = array_plugin("contact-lines").driver(port, MonotonicClock(), "f1", config, 5.0)
            array.connect()
            array.start(20.0)
            frames = [array.wait_frame(1.0) for _ in range(10)]
            array.stop()
        running.terminate()
    assert {frame.counts.item() for frame in frames} == {250}
    assert array.counters.faults == 0


def test_presses_show_whose_contacts_a_name_carries() -> None:
    with palpate.open_rig(CONTACT_RIG, seed=7) as opened:
        found = opened.doctor(press=True)
    assert [item.cause for item in found.findings if item.severity == "wrong"] == []
