"""Tests in which fingers touch a part near the middle of the table."""

from pathlib import Path

import pytest

from palpate.base.vocabulary import SESSIONS_FOLDER
from palpate.config import RigFile, RigOnBench
from palpate.jobs.rig import open_rig
from palpate.rig.identification.exploration import exploring_grip, fast_to_workspace
from palpate.rig.motion.guarded_approach import carry_out_grip
from palpate.rig.motion.hand import Hand
from palpate.rig.reach.approaches import reach_of
from palpate.testing.hardware.bench import Note

_AIM_COUNT = 41
_SESSIONS = Path(SESSIONS_FOLDER)


@pytest.mark.moves("one finger after the other goes to the middle until one meets the part that lies there")
def test_one_touch_of_a_part(rig: RigFile, hand: Hand, note: Note) -> None:
    """A finger meets it, measures it, presses no harder than it may, and comes back."""
    for way in exploring_grip(reach_of(rig, aims=_AIM_COUNT), []):
        name = hand.fingers[way.finger_index].name
        (touch,) = carry_out_grip(hand, [fast_to_workspace(way, rig.workspace.radius_mm)], lambda _: None)
        if touch.patch is None:
            note(f"{name}_touch", "none")
            continue
        pressed_n = max(touch.patch.force_n, *(load.peak_force_n for load in touch.loads))
        x_mm, y_mm = touch.contact.end_mm
        note(f"{name}_tip_mm", f"{x_mm:.2f}, {y_mm:.2f}")
        note("bound_mm", touch.contact.position_bound_mm)
        note("measured_n", touch.patch.force_n)
        note("pressed_n", pressed_n)
        assert touch.contact.touched
        assert pressed_n <= rig.closing.max_force_n
        return
    pytest.fail("no finger met anything: put a part near the middle of the table", pytrace=False)


@pytest.mark.needs_part
@pytest.mark.moves("fingers identify the part that `--part` names, as `palpate identify` does")
def test_a_known_part_is_identified(pytestconfig: pytest.Config, on_bench: RigOnBench, note: Note) -> None:
    """The answer is the part that lies there, and the only one."""
    part, objects = pytestconfig.getoption("part"), pytestconfig.getoption("objects")
    assert isinstance(on_bench.path, Path)
    note("part", part)
    with open_rig(on_bench.path) as rig:
        answer = rig.identify(
            objects,
            sessions=_SESSIONS,
            on_session=lambda folder: note("session", folder),
            notice=lambda text: note("notice", text),
            warn=lambda text: note("warning", text),
        )
    note("verdict", str(answer.verdict))
    note("answer", answer.object)
    note("bounds", answer.bounds)
    assert (str(answer.verdict), answer.object) == ("identified", part)
