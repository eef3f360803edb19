"""Building with the front door: touches, grips, planners and rigs of one's own, and scripts for labs."""

import ast
import csv
import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

import palpate
from palpate.rig.session.recorded_session import load_kept_inputs
from support.benches.rigs import quick_bench
from support.campaign.sampling import sample
from support.commands.repository import EXAMPLES, ROOT

LOOP = re.search(
    r"```python\n(objects = .*?recognition\.extend.*?)```", (ROOT / "docs/python.md").read_text(), re.S
)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Rig file and catalogue of a small bench."""
    return quick_bench(tmp_path_factory.mktemp("bench"))


@pytest.fixture(scope="module")
def brief(bench: tuple[Path, Path]) -> Path:
    """Rig file of that bench which gives up after a grip."""
    path = bench[0].with_name("brief.toml")
    path.write_text(bench[0].read_text().replace("max_grips = 12", "max_grips = 1"))
    return path


@pytest.fixture(scope="module")
def planned(bench: tuple[Path, Path]) -> palpate.Answer:
    """The answer of palpate's own run."""
    return palpate.open_rig(bench[0], seed=7).identify(bench[1])


@pytest.mark.parametrize("seed", sample(range(1, 13), [7]))
def test_the_loop_of_the_page_is_identify(
    bench: tuple[Path, Path], planned: palpate.Answer, seed: int
) -> None:
    """The same touches, to the last bit, and the same answer."""
    assert LOOP is not None
    assert LOOP[1].count("\n") <= 10
    text = LOOP[1].replace('"my-rig.toml"', f"{str(bench[0])!r}, seed={seed}")
    names: dict[str, object] = {}
    exec(text.replace('"my-parts.json"', repr(str(bench[1]))), {"palpate": palpate}, names)
    found = names["recognition"]
    assert isinstance(found, palpate.RigRecognition)
    answer = planned if seed == 7 else palpate.open_rig(bench[0], seed=seed).identify(bench[1])
    assert tuple(map(tuple, found.grips)) == answer.grips
    assert found.verdict == answer.verdict
    assert [item.state.object_name for item in found.hypotheses][:1] == [answer.object][
        : len(found.hypotheses)
    ]
    known = answer.run.result.recognition
    assert known is not None
    assert [item.bounds for item in found.hypotheses] == [item.bounds for item in known.hypotheses]
    assert len(answer.touches) == answer.result.touches == sum(len(grip.touches) for grip in found.grips)


def test_grips_are_values_that_may_be_taken_again_and_again(bench: tuple[Path, Path]) -> None:
    """A plan asked for twice is the same; a grip that was not planned is understood as what it is."""
    objects = palpate.load_objects(bench[1])
    with palpate.open_rig(bench[0], seed=7).connect(objects) as rig:
        nothing = rig.recognise(objects)
        planned = rig.plan(nothing)
        assert rig.plan(nothing) is planned
        grip = rig.grip(planned)
        assert [contact.name for contact in rig.touch(planned[0])] == [grip[0].name]
        once, again = nothing.extend(grip), nothing.extend(grip)
        assert nothing.grips == ()
        assert [h.bounds for h in once.hypotheses] == [h.bounds for h in again.hypotheses]
        finest = palpate.Goals(position_mm=1e-6, orientation_rad=1e-9)
        fast = max(rig.plan(once, finest), key=lambda item: item.fast_mm)
        assert fast.fast_mm > 1
        assert not rig.touch(fast.up_to(fast.fast_mm / 2))[0].touched
        rig.plan(nothing)
        with pytest.raises(palpate.InputError, match="of its way are known to be free"):
            rig.touch(fast)
        assert not once.goal_met
        with pytest.raises(palpate.InputError, match="MadeGrip"):
            once.extend(list(grip))  # type: ignore[arg-type]
    # What a rig has felt is contacts like any: without what is known of motions.
    alone = palpate.recognise(objects, grip)
    listed = palpate.recognise(objects, [grip[:2], grip[2:]])
    assert alone.verdict == listed.verdict
    assert alone.extend(grip[:1]).contacts.grips[-1] == grip[:1]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda ways: ways[:0], "one approach or several"),
        (lambda ways: [ways[0], ways[0]], "two approaches in one grip"),
        (lambda ways: [replace(ways[0], direction_rad=0.123)], "finger f1 is none of this rig"),
        (lambda ways: [replace(ways[0], travel_mm=1e3)], "goes 1000 mm; it must be"),
        (lambda ways: [replace(ways[0], touch_mm_s=1e3)], "touches at 1000 mm/s"),
        (lambda ways: [replace(ways[0], fast_mm=1e3)], "fast for 1000 mm"),
        (lambda ways: [replace(ways[0], fast_mm=ways[0].travel_mm)], "of its way are known to be free"),
        (lambda ways: [replace(ways[0], finger_index=9)], "of no finger"),
        (lambda ways: [ways], "one approach or several"),
        (lambda _: 3, "one approach or several"),
    ],
)
def test_a_grip_that_fingers_cannot_make_moves_nothing(
    bench: tuple[Path, Path], change: object, words: str
) -> None:
    with palpate.open_rig(bench[0]).connect() as rig:
        before = rig.hand.clock.now()
        with pytest.raises(palpate.InputError, match=words):
            rig.grip(change(rig.approaches))  # type: ignore[operator]
        assert rig.hand.clock.now() == before
        assert not rig.touch(rig.approaches[0].up_to(30.0))[0].touched, (
            "nothing lies there, and it still works"
        )


@pytest.mark.parametrize("raised", [palpate.SafetyStop("held"), KeyboardInterrupt()])
def test_torque_is_off_after_a_grip_that_failed_even_if_the_error_is_caught(
    bench: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, raised: BaseException
) -> None:
    switched = []
    with palpate.open_rig(bench[0]).connect() as rig:
        close = type(rig.hand).close
        monkeypatch.setattr(
            type(rig.hand), "close", lambda hand, error=None: switched.append(error) or close(hand, error)
        )

        def fail(_: float) -> None:
            raise raised

        monkeypatch.setattr(rig.hand, "pause", fail)
        with pytest.raises(type(raised)):
            rig.touch(rig.approaches[0])
        assert switched == [raised]
        with pytest.raises(palpate.InputError, match="connected no longer"):
            rig.touch(rig.approaches[0])
    assert switched == [raised]


def test_an_own_strategy_chooses_the_grips_and_ends_the_run(
    bench: tuple[Path, Path], planned: palpate.Answer, tmp_path: Path
) -> None:
    """It may ask palpate's planner; what it chooses is checked; its session says that it is not replayed."""
    rig = palpate.open_rig(bench[0], seed=7)
    own = rig.identify(bench[1], strategy=lambda known, planner: planner.plan(known), scene=None)
    assert own.result.strategy == "own"
    assert own.grips == planned.grips
    seen: list[int] = []

    def once(
        known: palpate.RigRecognition, planner: palpate.GripPlanner
    ) -> Sequence[palpate.FingerApproach] | None:
        seen.append(len(known.grips))
        return None if known.grips else planner.approaches[:1]

    answer = palpate.open_rig(bench[0], seed=7).identify(bench[1], strategy=once, sessions=tmp_path)
    assert (answer.verdict, len(answer.touches), seen) == ("unresolved", 1, [0, 1])
    with pytest.raises(palpate.InputError, match="not replayed"):
        palpate.open_session(answer.session or "").replay()
    with pytest.raises(palpate.InputError, match="two approaches"):
        rig.identify(bench[1], strategy=lambda _, planner: planner.approaches[:2])
    with pytest.raises(ZeroDivisionError):
        rig.identify(bench[1], strategy=lambda *_: 1 // 0)  # type: ignore[arg-type, return-value]


def test_a_changed_rig_is_checked_as_a_file_is(bench: tuple[Path, Path], tmp_path: Path) -> None:
    rig = palpate.open_rig(bench[0], seed=7)
    changed = rig.with_(closing={"search_speed_mm_s": 6}, fingers={"f2": {"tip": {"radius_mm": 4.9}}})
    assert changed.file.closing.search_speed_mm_s == 6.0
    assert [item.tip.radius_mm for item in changed.file.fingers][1] == 4.9
    assert rig.file == palpate.load_rig(bench[0])
    assert rig.with_().file == rig.file
    for tables, place in (
        ({"closing": {"search_speed_mm_s": -1}}, r"closing\.search_speed_mm_s"),
        ({"closing": {"search_sped_mm_s": 6}}, r"closing.*search_speed_mm_s"),
        ({"fingers": {"f9": {}}}, "fingers: there is none called 'f9'; f1"),
        ({"serach": {}}, "serach"),
        ({"fingers": {"f1": {"tip": {"radius_mm": "wide"}}}}, r"radius_mm"),
    ):
        with pytest.raises(palpate.InputError, match=place) as refused:
            rig.with_(**tables)  # type: ignore[arg-type]
        assert str(refused.value).startswith(f"change of {bench[0]}: ")
    with pytest.raises(palpate.InputError) as refused:
        palpate.open_rig().with_(closing={"search_speed_mm_s": -1})
    assert "bench.toml" not in str(refused.value)
    brief = changed.with_(search={"max_grips": 1})
    session = brief.identify(bench[1], sessions=tmp_path, strategy="planned").session
    kept, _, _ = load_kept_inputs(Path(session or ""), scene=False, calibration=False)
    assert kept.rig == brief.file
    assert brief.with_(search={"max_grips": changed.file.search.max_grips}).file == changed.file
    assert palpate.open_session(session or "").replay().difference is None
    with pytest.raises(palpate.InputError, match="change the file itself"):
        changed.calibrate()


@pytest.mark.parametrize("given", [3, [3], [[3]], {"f1"}, "none.json"])
def test_recognise_says_which_contacts_it_wants(given: object) -> None:
    with pytest.raises(palpate.InputError) as refused:
        palpate.recognise(None, given)  # type: ignore[arg-type]
    wanted = "none.json" if given == "none.json" else "a list of contacts or a list of grips, each a list"
    assert wanted in str(refused.value)


def test_a_plan_for_a_rig_is_refused_a_list_of_contacts_that_cannot_be_one_grip() -> None:
    fingers = (name for _ in range(2) for name in ("f1", "f2"))
    contacts = [
        palpate.Contact(name, palpate.Finger(5.0, 10.0), True, (0.0, -90.0), (0.0, -20.0), 0.2)
        for name in fingers
    ]
    with pytest.raises(palpate.InputError, match="finger f1 has two contacts in one grip"):
        palpate.plan(palpate.load_rig(), None, contacts)


def test_results_are_json(bench: tuple[Path, Path]) -> None:
    assert json.loads(palpate.scan().to_json())["format"] == "palpate/scan@1"
    studied = palpate.study(palpate.load_rig(bench[0]), palpate.load_objects(bench[1]), runs=1, workers=1)
    assert json.loads(studied.to_json())["format"] == "palpate/study@1"


# ----------------------------------------------------------------------------------------------------
# Scripts that labs want: by the documented door alone, none over 25 lines.

SCRIPTS = ("identify_ten", "own_planner", "own_order", "sweep_speed", "plot_array", "project/test_pick")


def script(*words: object, cwd: Path, **more: str) -> str:
    """What a script prints, in a process of its own."""
    env = os.environ | {"MPLBACKEND": "agg"} | more
    done = subprocess.run(
        [sys.executable, *map(str, words)], cwd=cwd, capture_output=True, text=True, check=False, env=env
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stderr + done.stdout
    return done.stdout


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_is_short_and_uses_the_documented_door(name: str) -> None:
    text = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8")
    assert text.count("\n") <= 25
    for node in ast.walk(ast.parse(text)):
        names = [item.name for item in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        assert not any(item.startswith("palpate.") for item in names)


@pytest.mark.slow
@pytest.mark.parametrize("number", sample([1, 10], [1]))
def test_ten_parts_in_a_row_to_a_table(bench: tuple[Path, Path], tmp_path: Path, number: int) -> None:
    script(EXAMPLES / "identify_ten.py", *bench, number, "found.csv", cwd=tmp_path)
    with (tmp_path / "found.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["verdict"] for row in rows] == ["identified"] * number
    assert len(list((tmp_path / "palpate-sessions").iterdir())) == number
    assert abs(float(rows[0]["x"])) < 50


def test_own_planner(bench: tuple[Path, Path], tmp_path: Path) -> None:
    assert "inside the bounds" in script(EXAMPLES / "own_planner.py", *bench, cwd=tmp_path)


def test_own_order(bench: tuple[Path, Path], tmp_path: Path) -> None:
    lines = script(EXAMPLES / "own_order.py", *bench, cwd=tmp_path).splitlines()
    assert [re.search(r"<Contact (f\d)", line)[1] for line in lines] == ["f1", "f2", "f3"] * 3  # type: ignore[index]


def test_a_sweep(bench: tuple[Path, Path], brief: Path, tmp_path: Path) -> None:
    _, *rows = script(EXAMPLES / "sweep_speed.py", brief, bench[1], cwd=tmp_path).splitlines()
    assert [float(row.split()[0]) for row in rows] == [4.0, 6.0, 10.0]


def test_a_live_plot(bench: tuple[Path, Path], tmp_path: Path) -> None:
    """Of a recorded run, which ends; its forces are those of touches."""
    pytest.importorskip("matplotlib")

    def touch_once(
        known: palpate.RigRecognition, planner: palpate.GripPlanner
    ) -> Sequence[palpate.FingerApproach] | None:
        return None if known.grips else planner.approaches[:1]

    rig = palpate.open_rig(bench[0], seed=7)
    session = rig.identify(bench[1], strategy=touch_once, sessions=tmp_path).session
    script(
        "-W", "ignore", EXAMPLES / "plot_array.py", session, "f1", cwd=tmp_path, MPLCONFIGDIR=str(tmp_path)
    )


# ----------------------------------------------------------------------------------------------------
# The fixture in other projects, where pytest finds it by the entry point.


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A folder with the entry point of the distribution on its path, as an installation has it."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["pytest11"]
    info = tmp_path / "site" / "palpate_entry-1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: palpate-entry\nVersion: 1\n")
    lines = "".join(f"{name} = {value}\n" for name, value in declared.items())
    (info / "entry_points.txt").write_text(f"[pytest11]\n{lines}")
    return tmp_path


def run_pytest(project: Path, *words: object) -> subprocess.CompletedProcess[str]:
    path = ":".join([str(project / "site"), *filter(None, sys.path)])
    env = os.environ | {"PYTHONPATH": path}
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-W",
        "error",
        *map(str, words),
    ]
    return subprocess.run(command, cwd=project, capture_output=True, text=True, check=False, env=env)


@pytest.mark.campaign
def test_the_example_of_another_project(project: Path) -> None:
    done = run_pytest(project, "--strict-markers", EXAMPLES / "project" / "test_pick.py")
    assert "1 passed" in done.stdout, done.stdout + done.stderr


def test_a_fixture_in_another_project(project: Path, bench: tuple[Path, Path], brief: Path) -> None:
    (project / "test_more.py").write_text(
        "import pytest\n"
        f"@pytest.mark.palpate_rig(seed=7, file={str(brief)!r})\n"
        f"def test_it(palpate_rig):\n    assert palpate_rig.identify({str(bench[1])!r}).touches\n"
        "def test_default(palpate_rig):\n    assert palpate_rig.file.name == 'bench'\n"
        "@pytest.mark.palpate_rig(7)\ndef test_wrong(palpate_rig): pass\n"
    )
    done = run_pytest(project, "--strict-markers", "-rA")
    assert "2 passed, 1 error" in done.stdout, done.stdout + done.stderr
    assert "the marker has these two, by name" in done.stdout


def test_a_run_that_does_not_use_the_fixture_does_not_load_palpate(project: Path) -> None:
    (project / "test_other.py").write_text(
        "import sys\ndef test_it():\n"
        "    assert 'palpate.pytest_plugin' in sys.modules and 'numpy' not in sys.modules\n"
        "    loaded = {name for name in sys.modules if name.startswith('palpate.')}\n"
        "    assert loaded == {'palpate.pytest_plugin'}\n"
    )
    done = run_pytest(project, "test_other.py")
    assert "1 passed" in done.stdout, done.stdout + done.stderr
