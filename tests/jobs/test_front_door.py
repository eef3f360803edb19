"""The front door: what `import palpate` offers does what the commands do, and leaves torque off."""

import ast
import json
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import palpate
from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.rig.conversion import grips_of
from palpate.rig.identification.events import Event, StageEvent, TouchEvent
from palpate.rig.motion.guarded_approach import GripPhase
from support.benches.rigs import firm_rig, quick_bench
from support.commands.command import PATIENCE_S, Here, bytes_sent, log_events, torque_writes
from support.commands.repository import EXAMPLES, ROOT

CONTACTS = EXAMPLES / "contacts.json"
NOT_COMPARED = ("wall_seconds", "session")


def program(*words: str | Path, cwd: Path, expect: int = 0) -> str:
    """Run Python with these arguments, as a user would; returns its standard output."""
    done = subprocess.run([sys.executable, *words], cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == expect, done.stderr
    return done.stdout


def last_torque(session: Path) -> dict[int, int]:
    """The last write of Torque Enable to each servo, by the session's log."""
    events = log_events(session / "session.jsonl.zst")
    return dict(torque_writes(bytes_sent(events, palpate.load_rig().bus.port)))


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Rig file and catalogue of a small bench."""
    return quick_bench(tmp_path_factory.mktemp("bench"))


@pytest.fixture(scope="module")
def answer(bench: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> palpate.Answer:
    """The answer of a run on it, whose session is kept."""
    rig_file, parts = bench
    with palpate.open_rig(rig_file, seed=7) as rig:
        return rig.identify(parts, sessions=tmp_path_factory.mktemp("answer"))


def test_importing_is_quick_and_every_name_is_there(tmp_path: Path) -> None:
    code = (
        "import sys, palpate; print('numpy' in sys.modules, all(getattr(palpate, n) for n in dir(palpate)))"
    )
    assert program("-W", "error", "-c", code, cwd=tmp_path).split() == ["False", "True"]
    with pytest.raises(AttributeError, match="no_such_name"):
        palpate.no_such_name  # type: ignore[attr-defined]  # noqa: B018


def test_the_module_is_the_command(tmp_path: Path) -> None:
    assert program("-m", "palpate", "--version", cwd=tmp_path) == f"palpate {palpate.__version__}\n"


def test_five_lines_give_the_answer_of_the_command(
    answer: palpate.Answer, bench: tuple[Path, Path], here: Here
) -> None:
    rig_file, parts = bench
    words = ("--rig", rig_file, "--objects", parts, "--seed", 7, "--json")
    told = here("identify", *words).json
    own = json.loads(answer.to_json())
    assert {k: v for k, v in own.items() if k not in NOT_COMPARED} == {
        k: v for k, v in told.items() if k not in NOT_COMPARED
    }
    assert (answer.object, answer.verdict) == (told["object"], told["verdict"])
    assert answer.bounds is not None
    assert list(answer.bounds.x) == told["bounds"]["x"]
    assert "<svg" in answer._repr_svg_()


def test_each_run_on_one_rig_draws_the_next_part_and_replays(
    bench: tuple[Path, Path], tmp_path: Path
) -> None:
    rig_file, parts = bench
    events: list[Event] = []
    with palpate.open_rig(rig_file, seed=3).with_(search={"max_grips": 1}) as rig:
        first, second = (rig.identify(parts, sessions=tmp_path, on_event=events.append) for _ in range(2))
    assert sum(isinstance(event, TouchEvent) for event in events) == first.result.grips + second.result.grips
    assert first.session != second.session
    assert first.result.truth is not None
    assert second.result.truth is not None
    assert first.result.truth.object != second.result.truth.object
    for answer in (first, second):
        assert answer.result.truth is not None
        assert answer.result.truth.inside_bounds
        assert answer.session is not None
        replayed = palpate.open_session(answer.session).replay()
        assert (replayed.difference, replayed.complete) == (None, True)


def test_reprs_are_one_short_line(answer: palpate.Answer) -> None:
    rig, objects = palpate.open_rig(firm_rig(), seed=7), palpate.load_objects()
    replayed = palpate.open_session(answer.session or "").replay()
    events: list[Event] = [StageEvent(1, GripPhase.CLOSING)]
    with rig.watch(["f1"], speed=None) as monitor, rig.connect(objects) as connected:
        values = [
            *events,
            *next(monitor.updates()),
            connected,
            connected.hand,
            connected.recognise(objects),
            connected.approaches[0],
            answer.touches[0],
            answer.grips[0][0],
            replayed,
            rig.file,
            palpate.load_contacts(EXAMPLES / "contacts.json"),
            palpate.load_references(),
            objects.objects[0].states[0],
            answer.result,
            answer.run,
            answer.run.job.catalogue,
            rig,
            objects,
            objects.objects[0],
            answer,
            palpate.recognise(objects, EXAMPLES / "contacts.json"),
            rig.plan(objects, EXAMPLES / "contacts.json"),
            rig.check(),
            palpate.open_session(answer.session or ""),
            palpate.list_objects(rig.file, objects),
            monitor,
        ]
    for value in values:
        assert "\n" not in repr(value)
        assert len(repr(value)) < 250


@pytest.mark.parametrize(
    ("load", "source"),
    [
        (palpate.load_objects, None),
        (palpate.load_rig, None),
        (palpate.load_rig, EXAMPLES / "two-link-rig.toml"),
        (palpate.load_rig, EXAMPLES / "real-rig.toml"),
        (palpate.load_contacts, EXAMPLES / "contacts.json"),
        (palpate.load_scene, EXAMPLES / "scene.json"),
        (palpate.load_references, None),
    ],
)
def test_what_is_saved_loads_as_the_same_value(load: object, source: Path | None, tmp_path: Path) -> None:
    value = load(source)  # type: ignore[operator]
    palpate.save(value, tmp_path / "file")
    assert load(tmp_path / "file") == value  # type: ignore[operator]
    with pytest.raises(palpate.InputError, match="save: value is 3"):
        palpate.save(3, tmp_path / "other")  # type: ignore[arg-type]
    assert not (tmp_path / "other").exists()


OUTLINE = [[0.0, 0.0], [70.0, 0.0], [70.0, 25.0], [55.0, 40.0], [0.0, 40.0]]
BOW = [[0.0, 0.0], [70.0, 40.0], [70.0, 0.0], [0.0, 40.0]]


def model(outline: list[list[float]]) -> ObjectModel:
    section = Section((0.0, 20.0), (Polygon(np.array(outline)),))
    return ObjectModel("plate", (State("flat", (section,)),))


def test_objects_made_in_python_are_those_of_their_file(tmp_path: Path) -> None:
    table = {"name": "plate", "outline": OUTLINE, "height": 20.0}
    loaded = palpate.load_objects({"objects": [table]})
    palpate.save([model(OUTLINE)], tmp_path / "parts.json")
    assert palpate.load_objects(tmp_path / "parts.json") == loaded == palpate.load_objects([model(OUTLINE)])
    finger = palpate.Finger(5.0, 10.0)
    contact = palpate.Contact("f1", finger, True, (20.0, -60.0), (20.0, -5.0), 0.2)
    for objects in (loaded, [model(OUTLINE)], {"objects": [table]}):
        assert palpate.recognise(objects, [contact]).hypotheses[0].state.object_name == "plate"
    for wrong in ([model(BOW)], {"objects": [table | {"outline": BOW}]}):
        with pytest.raises(palpate.InputError, match=r'object "plate".*intersects itself'):
            palpate.recognise(wrong, [contact])


def test_a_scene_is_a_dict_as_its_file_is(tmp_path: Path) -> None:
    given = {"object": "gator", "configuration": {"x": 3.0, "y": -8.0, "theta": 0.5}}
    with palpate.open_rig(seed=7).connect(scene=given) as rig:
        assert rig.approaches
    palpate.save(palpate.load_scene(given), tmp_path / "scene.json")
    assert palpate.load_scene(tmp_path / "scene.json") == palpate.load_scene(given)
    with pytest.raises(palpate.InputError, match='"configuration" is missing'):
        palpate.open_rig(seed=7).identify(scene={"object": "gator"})


def test_contacts_made_in_python_become_their_file(tmp_path: Path) -> None:
    finger, path = palpate.Finger(2.0, 10.0, 1.0), tmp_path / "contacts.json"
    normal = palpate.NormalRange(-1.8, -1.4)
    touch = palpate.Contact(
        "f1", finger, True, (20.0, -60.0), (20.0, -5.0), 0.2, normal, path_bound_mm=0.3, friction=0.4
    )
    miss = palpate.Contact("f2", palpate.Finger(2.0, 10.0), False, (90.0, -60.0), (90.0, 60.0), 0.2)
    for given, grips in (
        ([touch, miss], [[touch, miss]]),
        ([touch, miss, touch], [[touch], [miss], [touch]]),
        ([[touch, miss], (touch,)], [[touch, miss], [touch]]),
    ):
        palpate.save(given, path)
        assert grips_of(palpate.load_contacts(path)) == grips
    with pytest.raises(palpate.InputError, match="start a new grip"):
        palpate.save([[touch, touch]], path)
    with pytest.raises(palpate.InputError, match="turn_bound_rad"):
        palpate.save([replace(touch, turn_bound_rad=0.1)], path)


def test_a_signal_that_would_end_a_script_switches_torque_off_first(
    bench: tuple[Path, Path], tmp_path: Path
) -> None:
    rig_file, parts = map(str, bench)
    code = f"""
import os, palpate
from palpate.rig.identification.events import TouchEvent

def stop(event):
    if isinstance(event, TouchEvent):
        os.kill(os.getpid(), {int(signal.SIGTERM)})

palpate.open_rig({rig_file!r}, seed=7).identify({parts!r}, sessions=".", on_event=stop)
"""
    program("-W", "error", "-c", code, cwd=tmp_path, expect=128 + signal.SIGTERM)
    (session,) = tmp_path.glob("identify-*")
    assert set(last_torque(session).values()) == {0}
    replayed = palpate.open_session(session).replay()
    assert (replayed.difference, replayed.complete) == (None, True)


def test_handlers_of_signals_are_as_before() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    with palpate.open_rig() as rig:
        rig.check()
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)] == before


@pytest.mark.parametrize(
    ("raised", "ended", "words"),
    [
        (RuntimeError("out of paper"), palpate.OutputError, "out of paper"),
        (KeyboardInterrupt(), KeyboardInterrupt, "torque is off"),
    ],
)
def test_an_observer_that_raises_ends_the_run_in_order(
    raised: BaseException,
    ended: type[BaseException],
    words: str,
    bench: tuple[Path, Path],
    tmp_path: Path,
) -> None:
    """As an error of the output, or at once as Ctrl-C does; torque is off."""

    def fail(event: Event) -> None:
        raise raised

    with pytest.raises(ended, match=words):
        palpate.open_rig(bench[0], seed=7).identify(bench[1], sessions=tmp_path, on_event=fail)
    (session,) = tmp_path.iterdir()
    assert set(last_torque(session).values()) == {0}


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda rig: palpate.plan(rig, None, CONTACTS), "plan: rig is <Rig .*RigFile"),
        (lambda _: palpate.plan("rig.toml", None, CONTACTS), "plan: rig is 'rig.toml'.*RigFile"),
        (lambda rig: palpate.open_rig(rig.file), "path is <RigFile .*a path or None"),
        (
            lambda _: palpate.recognise(None, CONTACTS, max_spurious=1.5),
            "max_spurious is 1.5.*whole number",
        ),
        (lambda rig: rig.watch(rate_hz="30"), "rate_hz is '30'.*a number"),
        (lambda rig: rig.identify(on_event=3), "on_event is 3.*a function"),
    ],
)
def test_a_wrong_kind_of_argument_is_named_with_what_is_allowed(
    call: Callable[[Any], object], words: str
) -> None:
    with pytest.raises(palpate.InputError, match=words):
        call(palpate.open_rig())


FINGER = palpate.Finger(2.0, 10.0)
TOUCH: dict[str, Any] = {
    "name": "f1",
    "finger": FINGER,
    "touched": True,
    "start_mm": (0.0, -60.0),
    "end_mm": (0.0, -5.0),
    "position_bound_mm": 0.2,
}


@pytest.mark.parametrize(
    "make",
    [
        lambda: palpate.Finger("a", 10.0),  # type: ignore[arg-type]
        lambda: palpate.NormalRange("a", 1.0),  # type: ignore[arg-type]
        lambda: palpate.Contact(**TOUCH | {"touched": "no"}),
        lambda: palpate.Contact(**TOUCH | {"finger": "f1"}),
        lambda: palpate.Contact(**TOUCH | {"start_mm": (0.0, 0.0, 0.0)}),
        lambda: palpate.Contact(**TOUCH | {"end_mm": 3.0}),
        lambda: palpate.Contact(**TOUCH | {"position_bound_mm": "small"}),
        lambda: palpate.Goals(-1.0, 0.1),
        lambda: palpate.Goals(1.0, "a"),  # type: ignore[arg-type]
        lambda: palpate.FingerApproach(FINGER, (0.0, 0.0), 0.0, 10.0, 0.1).up_to(-5.0),
    ],
)
def test_values_that_cannot_be_are_refused_where_they_are_made(make: Callable[[], object]) -> None:
    with pytest.raises(palpate.InputError):
        make()


def test_messages_name_no_options_of_the_command_line() -> None:
    rooms = ("jobs", "base", "cad", "calibration", "config", "drivers", "recognizer", "rig")
    paths = [path for room in rooms for path in (ROOT / "src" / "palpate" / room).rglob("*.py")]
    assert len(paths) > 200
    completes_commands = ROOT / "src" / "palpate" / "base" / "errors.py"
    for path in set(paths) - {completes_commands}:
        tree = ast.parse(path.read_text())
        texts = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)]
        for text in (text for text in texts if isinstance(text, str) and "\n" not in text):
            assert not re.search(r"--[a-z]", re.sub(r"palpate [a-z]+.*", "", text)), f"{path}: {text}"


def test_an_answer_that_cannot_be_written_down_is_still_an_answer(
    bench: tuple[Path, Path], tmp_path: Path, here: Here
) -> None:
    rig_file, parts = bench
    brief = tmp_path / "brief.toml"
    brief.write_text(rig_file.read_text().replace("max_grips = 12", "max_grips = 1"))
    answer = palpate.open_rig(brief, seed=7).identify(parts, sessions=tmp_path / "whole")
    (tmp_path / Path(answer.session or "").name / "picture.svg").mkdir(parents=True)
    again = palpate.open_rig(brief, seed=7).identify(parts, sessions=tmp_path)
    assert (again.object, again.verdict) == (answer.object, answer.verdict)
    assert again.result.touches > 0
    assert "picture.svg" in str(again.failure)
    assert "picture.svg" in repr(again)
    words = ("--rig", brief, "--objects", parts, "--seed", 7, "--sessions", tmp_path, "--json")
    told = here("identify", *words)
    assert (told.code, told.json["object"], told.json["verdict"]) == (2, answer.object, answer.verdict)
    assert "picture.svg" in told.err


def test_the_shipped_rig_is_not_calibrated_and_says_what_to_do() -> None:
    with pytest.raises(palpate.InputError, match="copy its rig file"):
        palpate.open_rig().calibrate()


def test_contacts_only(tmp_path: Path) -> None:
    script, contacts = EXAMPLES / "recognise_contacts.py", EXAMPLES / "contacts.json"
    assert "unique: 1 hypotheses" in program(script, contacts, cwd=tmp_path)


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("name", ["identify", "several_parts", "learn_a_part"])
def test_the_notebook_runs_from_the_first_cell_to_the_last(name: str, tmp_path: Path) -> None:
    import nbformat
    from nbclient import NotebookClient

    for rig in ("firm-rig.toml", "turning-rig.toml"):
        shutil.copy(EXAMPLES / rig, tmp_path)
    notebook = nbformat.read(EXAMPLES / f"{name}.ipynb", as_version=4)
    NotebookClient(notebook, timeout=PATIENCE_S, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/svg+xml" in output.get("data", {}) for output in outputs)
    assert not any(output["output_type"] == "error" for output in outputs)


def test_parts_that_are_refused_are_told(read_here: None) -> None:
    step = Path(__file__).parents[1] / "cad" / "step" / "plate_and_chip.step"
    with pytest.warns(palpate.RigWarning, match=r"plate_and_chip.step: .*0\.5"):
        found = palpate.import_objects(step)
    assert [item.name for item in found.objects] == ["plate_and_chip"]
