"""Sessions of connections: grips that a program chose, and their replay."""

import json
import re
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import palpate
from palpate.base.errors import InputError
from palpate.jobs.recognition import contact_record
from palpate.rig.session.archive import remove_sessions, summary_of
from support.benches.rigs import quick_bench
from support.commands.command import Here, copied, log_events, log_lines


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Rig file and catalogue of a small bench."""
    return quick_bench(tmp_path_factory.mktemp("bench"))


@pytest.fixture(scope="module")
def two_grips(
    bench: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, list[palpate.MadeGrip]]:
    """The folder of a session of two grips, and the grips."""
    objects, made = palpate.load_objects(bench[1]), []
    sessions = tmp_path_factory.mktemp("sessions")
    with palpate.open_rig(bench[0], seed=7).connect(objects, sessions=sessions) as rig:
        recognition = rig.recognise(objects)
        for _ in range(2):
            made.append(rig.grip(rig.plan(recognition)))
            recognition = recognition.extend(made[-1])
    assert rig.session is not None
    assert rig.session.parent == sessions
    return rig.session, made


def test_the_grips_come_about_again(two_grips: tuple[Path, list[palpate.MadeGrip]], here: Here) -> None:
    folder, made = two_grips
    replayed = palpate.open_session(folder).replay()
    assert (replayed.difference, replayed.complete, replayed.run) == (None, True, None)
    assert replayed.lines == len(log_events(folder / "session.jsonl.zst")) - 1
    kept = contact_record(folder / "contacts.json").grips
    assert [tuple(grip) for grip in kept] == [tuple(grip) for grip in made]
    summary = summary_of(folder)
    assert (summary.command, summary.grips, summary.verdict) == ("connect", 2, None)
    assert summary.touches == sum(contact.touched for grip in made for contact in grip)
    done = here("replay", folder, "--json")
    assert (done.code, done.json["same"], done.json["verdict"]) == (0, True, None)


def test_pages_and_exports_are_made_of_it(
    two_grips: tuple[Path, list[palpate.MadeGrip]], here: Here, tmp_path: Path
) -> None:
    assert here("report", two_grips[0], "--out", tmp_path / "report.html").code == 0
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("<h2>Grip ") == 2
    assert "rival" not in page
    done = here(
        *("export", two_grips[0], "--csv", tmp_path / "csv", "--mcap", tmp_path / "run.mcap"),
        *("--rosbag", tmp_path / "bag", "--animation", tmp_path / "run.svg", "--json"),
    )
    assert done.code == 0
    messages = {Path(item["path"]).name: item["messages"] for item in done.json["written"]}
    assert messages["run.mcap"]["/contacts"] == 2
    assert messages["run.mcap"]["/events/grip"] == 2


class ProgramError(Exception):
    """An error of the program that has the rig connected."""


@pytest.fixture
def heeds_interrupts() -> Iterator[None]:
    """SIGINT raises KeyboardInterrupt, also where whatever started the tests has it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupt_soon() -> None:
    threading.Timer(0.2, lambda: signal.raise_signal(signal.SIGINT)).start()


def fail() -> None:
    raise ProgramError("the arm is in the way")


@pytest.mark.parametrize(
    ("before", "after", "how"),
    [(lambda: None, fail, "ProgramError"), (interrupt_soon, lambda: None, "KeyboardInterrupt")],
)
@pytest.mark.usefixtures("heeds_interrupts")
def test_whatever_ends_it_ends_the_replay(
    bench: tuple[Path, Path],
    tmp_path: Path,
    before: Callable[[], None],
    after: Callable[[], None],
    how: str,
) -> None:
    def program() -> None:
        objects = palpate.load_objects(bench[1])
        with palpate.open_rig(bench[0], seed=7).connect(objects, sessions=tmp_path) as rig:
            before()
            for _ in range(4):
                rig.grip(rig.approaches[:1])
            after()

    with pytest.raises((ProgramError, KeyboardInterrupt)):
        program()
    (folder,) = tmp_path.iterdir()
    assert log_events(folder / "session.jsonl.zst")[-1]["how"] == how
    replayed = palpate.open_session(folder).replay()
    assert (replayed.difference, replayed.complete) == (None, True)


def touch_all(rig: palpate.ReadyRig) -> None:
    for approach in rig.approaches:
        rig.touch(approach)


def test_a_grip_that_fails_ends_the_session_there(bench: tuple[Path, Path], tmp_path: Path) -> None:
    """The program may go on after it; its session ends with the grip."""
    text = bench[0].read_text(encoding="utf-8")
    hard, number = re.subn(r"max_force_n = [0-9.]+", "max_force_n = 0.35", text)
    assert number == 1
    (tmp_path / "hard.toml").write_text(hard)
    with palpate.open_rig(tmp_path / "hard.toml", seed=7).connect(
        palpate.load_objects(bench[1]), sessions=tmp_path / "sessions"
    ) as rig:
        with pytest.raises(palpate.PalpateError) as caught:
            touch_all(rig)
        assert not rig.is_connected
    assert rig.session is not None
    end = log_events(rig.session / "session.jsonl.zst")[-1]
    assert (end["how"], end["message"]) == (type(caught.value).__name__, str(caught.value))
    replayed = palpate.open_session(rig.session).replay()
    assert (replayed.difference, replayed.complete) == (None, True)


def test_another_approach_than_was_carried_out_is_a_difference(
    two_grips: tuple[Path, list[palpate.MadeGrip]], tmp_path: Path
) -> None:
    def change(lines: list[str]) -> list[str]:
        found = []
        for line in lines:
            values = json.loads(line)
            if values["event"] == "grip" and values["grip"] == 2:
                values["approaches"][0]["direction_rad"] += 0.02
            found.append(json.dumps(values) + "\n")
        return found

    replayed = palpate.open_session(copied(two_grips[0], tmp_path, change)).replay()
    assert replayed.difference is not None
    assert 0 < replayed.lines < len(log_lines(two_grips[0] / "session.jsonl.zst"))


@pytest.mark.parametrize("wrong", [None, [{}], [{"finger_index": 9}], "x", 3])
def test_what_palpate_does_not_write_is_refused(
    two_grips: tuple[Path, list[palpate.MadeGrip]], tmp_path: Path, wrong: object
) -> None:
    def change(lines: list[str]) -> list[str]:
        events = [json.loads(line) for line in lines]
        for values in events:
            if values["event"] == "grip":
                values["approaches"] = wrong
        return [json.dumps(values) + "\n" for values in events]

    with pytest.raises(InputError, match="approaches"):
        palpate.open_session(copied(two_grips[0], tmp_path, change)).replay()


def test_a_log_that_was_cut_off_replays_up_to_there(
    two_grips: tuple[Path, list[palpate.MadeGrip]], tmp_path: Path
) -> None:
    folder = copied(two_grips[0], tmp_path, lambda lines: lines[: 2 * len(lines) // 3])
    replayed = palpate.open_session(folder).replay()
    assert (replayed.difference, replayed.complete) == (None, False)
    assert replayed.sent_bytes > 0


def test_learning_is_kept_as_a_session(bench: tuple[Path, Path], tmp_path: Path, here: Here) -> None:
    done = here(
        *("objects", "learn", "part", "--height", "18", "--rig", bench[0], "--seed", "7"),
        *("--max-seconds", "15", "--sessions", tmp_path / "kept", "--json"),
    )
    assert done.code == 1
    (folder,) = (tmp_path / "kept").iterdir()
    assert json.loads((folder / "result.json").read_text()) == done.json
    summary = summary_of(folder)
    assert (summary.command, summary.verdict, summary.grips) == ("learn", "not learned", done.json["grips"])
    assert here("replay", folder).code == 0
    again = palpate.open_rig(bench[0], seed=7).learn(
        "part", height_mm=18.0, max_seconds=1.0, contacts=folder / "contacts.json"
    )
    assert len(again.grips) > done.json["grips"] - 1


@pytest.mark.parametrize("name", ["contacts.json", "result.json"])
def test_what_was_learned_is_not_lost_where_its_session_cannot_be_written(
    bench: tuple[Path, Path], tmp_path: Path, name: str
) -> None:
    said: list[str] = []

    def spoil(_: str) -> None:
        (folder,) = tmp_path.iterdir()
        (folder / name).mkdir(exist_ok=True)

    learned = palpate.open_rig(bench[0], seed=7).learn(
        "part", height_mm=18.0, max_seconds=12.0, sessions=tmp_path, progress=spoil, notice=said.append
    )
    assert learned.touch_count > 0
    assert learned.session is None
    assert sum(name in line for line in said) == 1


def test_an_error_of_the_program_is_what_is_said_where_contacts_cannot_be_written(
    bench: tuple[Path, Path], tmp_path: Path
) -> None:
    def program() -> None:
        with palpate.open_rig(bench[0]).connect(sessions=tmp_path) as rig:
            assert rig.session is not None
            (rig.session / "contacts.json").mkdir()
            fail()

    with pytest.raises(ProgramError):
        program()


def test_nothing_of_a_session_stays_that_palpate_wrote(
    two_grips: tuple[Path, list[palpate.MadeGrip]], tmp_path: Path
) -> None:
    """Neither what `learn` adds nor the confirmed wiring of a real rig."""
    folder = copied(two_grips[0], make(tmp_path / "session"), lambda lines: lines)
    for name in ("rig.confirmed.toml", "result.json", "picture.svg"):
        (folder / name).write_text("")
    assert remove_sessions([summary_of(folder)]).kept_folders == ()
    assert not folder.exists()


def make(folder: Path) -> Path:
    folder.mkdir()
    return folder
