"""`palpate sessions` and `palpate schema`."""

import json
import re
import shutil
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from palpate.config import shipped_rig
from palpate.config.schema import FORMATS, schema_text
from palpate.drivers.transport.clock import VirtualClock
from palpate.rig.session.log import SessionLog
from support.commands.command import Here, log_bytes, until, violations

# ----------------------------------------------------------------------------------------------------
# `palpate sessions`, `sessions prune` and `info`: what a folder of recorded runs holds, and what may go.

NOW = datetime.now(UTC).replace(microsecond=0)
ROOT = Path("palpate-sessions")


def log_of(name: str, days: float = 0.0, **header: object) -> SessionLog:
    folder = ROOT / name
    folder.mkdir(parents=True)
    (folder / "rig.toml").write_text("name = 'bench'\n")
    started = (NOW - timedelta(days=days)).isoformat()
    values = {"palpate": "0.1.0", "rig": "bench", "seed": 7, "emulated": True, "started": started}
    return SessionLog(folder, VirtualClock(), values | header)


def recorded(name: str, days: float = 0.0, verdict: str = "identified", **header: object) -> Path:
    with log_of(name, days, **header) as log:
        touches = [{"contact": {"touched": True}}, {"contact": {"touched": False}}]
        log.event("touches", grip=1, touches=touches)
        log.event("touches", grip=2, touches=touches[:1])
        log.event("result", result={"verdict": verdict, "object": "hand", "state": "flat"})
    return ROOT / name


def killed(name: str, days: float = 0.0) -> Path:
    with log_of(name, days) as log:
        until_flushed(log)
        left = log.path.read_bytes()
    log.path.write_bytes(left)
    return log.path.parent


def until_flushed(log: SessionLog) -> None:
    until(lambda: log_bytes(log.path))


@pytest.fixture
def running(here: Here) -> Iterator[Path]:
    with log_of("d-running", 5) as log:
        until_flushed(log)
        yield ROOT / "d-running"


def listed(here: Here) -> dict[str, dict[str, object]]:
    ended = here("sessions", "--json")
    assert (ended.code, ended.err) == (0, "")
    assert violations(ended.json, json.loads(schema_text("sessions"))) == []
    return {Path(item["path"]).name: item for item in ended.json["sessions"]}


def test_a_list_says_what_was_found_and_how_each_ended(here: Here, running: Path) -> None:
    recorded("b-whole", 2)
    recorded("a-real", 1, emulated=False)
    killed("c-killed", 3)
    with pytest.raises(ValueError, match="gone"), log_of("e-failed"):
        raise ValueError("gone")
    found = listed(here)
    assert list(found) == ["d-running", "c-killed", "b-whole", "a-real", "e-failed"], "by age"
    assert [item["verdict"] for item in found.values()] == [None, None, "identified", "identified", None]
    assert [item["writing"] for item in found.values()] == [True, False, False, False, False]
    assert [item["emulated"] for item in found.values()] == [True, True, True, False, True]
    assert found["b-whole"]["ended"] == {"how": "done", "message": None}
    assert found["c-killed"]["ended"] is None
    assert found["e-failed"]["ended"] == {"how": "ValueError", "message": "gone"}
    assert (found["b-whole"]["grips"], found["b-whole"]["touches"]) == (2, 2)
    assert found["b-whole"]["bytes"] == sum(p.stat().st_size for p in (ROOT / "b-whole").iterdir())
    shown = here("sessions").out
    for words in (
        "running",
        "killed",
        "identified: hand, flat",
        "none (value error)",
        "5 sessions",
    ):
        assert words in shown


def test_what_cannot_be_read_is_listed_and_the_rest_all_the_same(here: Here) -> None:
    recorded("good")
    (ROOT / "bad").mkdir()
    (ROOT / "bad" / "session.jsonl.zst").write_bytes(b"no stream at all")
    (ROOT / "notes").mkdir()
    (ROOT / "notes" / "todo.txt").write_text("of somebody")
    ended = here("sessions")
    assert ended.code == 0
    assert "good" in ended.out
    assert re.search(r"! bad: .*is no Zstandard stream", ended.out)
    assert "notes" not in ended.out


def test_where_there_is_no_folder_a_line_says_so(here: Here) -> None:
    ended = here("sessions")
    assert (ended.code, ended.out) == (2, "")
    assert "palpate-sessions: there is no such folder; runs make it where they are started" in ended.err
    for words in (("info", "nowhere"), ("sessions", "--sessions", "nowhere")):
        ended = here(*words)
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert "there is no such folder" in ended.err


def test_what_is_no_session_is_said_alike_by_all_commands(here: Here) -> None:
    """And where the session may be that was meant."""
    folder = recorded("one")
    Path("notes.txt").write_text("x")
    lists = f"`palpate sessions --sessions {ROOT}` lists those below it"
    wrong = {
        "nowhere": "there is no such folder",
        "notes.txt": "it is a file, and none of the name session.jsonl.zst",
        folder.name: f"there is no such folder; {folder} is one",
        str(ROOT): f"there is no session.jsonl.zst in it; {lists}",
    }
    commands = (["info"], ["report"], ["replay"], ["view"], ["export", "--csv", "x"], ["watch", "--session"])
    for name, why in wrong.items():
        for command in commands:
            ended = here(*command, name)
            assert (ended.code, ended.out) == (2, "")
            assert ended.err == f"error: {name} is not a session: {why}\n"


def test_info_is_of_a_folder_or_its_log(here: Here) -> None:
    folder = recorded("one")
    said = here("info", folder)
    assert (said.code, said.err) == (0, "")
    assert here("info", folder / "session.jsonl.zst").out == said.out
    for words in ("bench (emulated), seed 7, without a calibration", "2 grips, 2 touches", "ended    done"):
        assert words in said.out


@pytest.mark.parametrize(
    ("options", "left"),
    [
        (("--keep", 2), {"d-running", "b", "a"}),
        (("--keep", 0), {"d-running"}),
        (("--older-than", 2.5), {"b", "a", "d-running"}),
        (("--keep", 1, "--older-than", 3.5), {"c", "b", "a", "d-running"}),
        (("--keep", 0, "--dry-run"), {"e", "c", "d-running", "b", "a"}),
    ],
)
def test_prune_takes_the_oldest_but_none_that_runs(
    here: Here, running: Path, options: tuple[object, ...], left: set[str]
) -> None:
    for name, days in (("a", 1), ("b", 2), ("c", 3), ("e", 6)):
        recorded(name, days)
    ended = here("sessions", "prune", *options)
    assert (ended.code, ended.err) == (0, "")
    assert {path.name for path in ROOT.iterdir()} == left
    assert set(listed(here)) == left


def test_prune_needs_to_be_told_what_may_go(here: Here) -> None:
    recorded("a")
    ended = here("sessions", "prune")
    assert (ended.code, ended.out) == (2, "")
    assert "--keep N, --older-than DAYS" in ended.err
    assert list(listed(here)) == ["a"]


def test_what_others_put_into_a_session_stays(here: Here) -> None:
    folder = recorded("a")
    (folder / "photo.jpg").write_bytes(b"a photo")
    ended = here("sessions", "prune", "--keep", 0)
    assert "stays: it holds other files" in ended.err
    assert [path.name for path in folder.iterdir()] == ["photo.jpg"]


def test_what_programs_rely_on(here: Here) -> None:
    folder = recorded("one")
    (one,) = here("sessions", "--json").json["sessions"]
    relied_on = {"path", "began", "command", "verdict", "object", "emulated", "seed", "ended", "bytes"}
    assert relied_on <= set(one)
    assert (one["command"], Path(one["path"]).name) == ("identify", "one")
    shutil.copy(shipped_rig(), folder / "rig.toml")
    told = here("info", folder, "--json").json
    assert violations(told, json.loads(schema_text("session-info"))) == []
    assert told["format"] == "palpate/session-info@1"
    assert {key: told[key] for key in one if key != "bytes"} == {
        key: one[key] for key in one if key != "bytes"
    }
    assert [item["port"] for item in told["devices"]] == ["mock://bus", "mock://f1", "mock://f2", "mock://f3"]
    assert told["devices"][0]["devices"][1] == "XM430-W350, id 12: f1 slide"
    assert told["versions"] == {"palpate": "0.1.0"}


# ----------------------------------------------------------------------------------------------------
# `palpate schema`: what is printed is what is shipped, and editors find it.


def test_all_names_are_listed(here: Here) -> None:
    assert here("schema").out.split() == sorted(FORMATS)


@pytest.mark.parametrize("name", sorted(FORMATS))
def test_each_schema_is_printed(here: Here, name: str) -> None:
    ended = here("schema", name)
    assert (ended.code, ended.out) == (0, schema_text(name))


def test_it_is_written_beside_a_rig_file(here: Here, tmp_path: Path) -> None:
    assert here("schema", "rig", "--out", "rig.schema.json").code == 0
    assert json.loads((tmp_path / "rig.schema.json").read_text())["title"]


def test_an_unknown_name_is_refused_with_those_that_there_are(here: Here) -> None:
    ended = here("schema", "rigg")
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert 'there is no format "rigg"' in ended.err
    assert "rig, scan" in ended.err
    assert here("schema", "--out", "x.json").code == 2
