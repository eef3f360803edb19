"""Windows and macOS: what opens no serial device works without the modules that those systems lack.

The commands run in processes in which palpate finds none of those modules and names, and which are spawned
(`support/other_system`). That is no Windows: its files, its terminal and its ports have not been tried.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from support.benches.rigs import firm_rig, quicken, small, small_parts
from support.commands.command import PATIENCE_S, Ended
from support.commands.repository import EXAMPLES, PACKAGE, ROOT

pytestmark = pytest.mark.slow

PLATE = """<svg xmlns="http://www.w3.org/2000/svg" width="40mm" height="30mm" viewBox="0 0 40 30">
<path d="M0 0H40V30H20V15H0Z"/></svg>"""


def python(*words: object, cwd: Path) -> Ended:
    """Run Python as it would be on such a system, with an encoding that lacks most letters."""
    path = (ROOT / "tests" / "support" / "other_system", PACKAGE.parent)
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, path)),
        "PYTHONIOENCODING": "cp1252",
        "PYTHONWARNDEFAULTENCODING": "1",
    }
    done = subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=cwd,
        env=environment,
        capture_output=True,
        encoding="utf-8",
        timeout=PATIENCE_S,
        check=False,
    )
    return Ended(done.returncode, done.stdout, done.stderr)


def palpate(*words: object, cwd: Path) -> str:
    """Run a command there; its standard output."""
    done = python("-m", "palpate", *words, cwd=cwd)
    assert done.code == 0, done.err
    return done.out


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a rig, its objects, a drawing, and a session of an identification."""
    made = tmp_path_factory.mktemp("other-system")
    (made / "rig.toml").write_text(quicken(small(firm_rig())), encoding="utf-8")
    small_parts(made)
    (made / "plate.svg").write_text(PLATE, encoding="utf-8")
    asked = ("--rig", "rig.toml", "--objects", "small-parts.json", "--seed", 7, "--sessions", "sessions")
    answer = palpate("identify", *asked, "--json", cwd=made)
    assert json.loads(answer)["verdict"] == "identified"
    return made


@pytest.fixture(scope="module")
def session(folder: Path) -> Path:
    (found,) = (folder / "sessions").iterdir()
    return found


IMPORT_ALL = """
import importlib, json, pkgutil, sys
import palpate
from palpate.cli import watch_display
assert not hasattr(watch_display, "termios"), "nothing is hidden"
for found in pkgutil.walk_packages(palpate.__path__, "palpate."):
    if ".testing.hardware.test_" not in found.name and not found.name.endswith((".__main__", ".conftest")):
        importlib.import_module(found.name)
"""


def test_every_module_can_be_imported(tmp_path: Path) -> None:
    assert python("-c", IMPORT_ALL, cwd=tmp_path).err == ""


def test_a_session_is_replayed_reported_and_exported(folder: Path, session: Path) -> None:
    assert "all as recorded" in palpate("replay", session, cwd=folder)
    assert session.name in palpate("sessions", "--sessions", "sessions", cwd=folder)
    palpate("report", session, cwd=folder)
    palpate("export", session, "--csv", "csv", cwd=folder)
    assert "θ" in (session / "report.html").read_text(encoding="utf-8")
    assert (folder / "csv" / "contacts.csv").is_file()


def test_contacts_are_recognized_and_the_next_grip_planned(folder: Path) -> None:
    given = ("--contacts", EXAMPLES / "contacts.json")
    memo = ("--objects", PACKAGE / "config" / "objects" / "memo.json")
    assert "θ" in palpate("recognize", *given, *memo, cwd=folder), "in words, into a pipe"
    assert json.loads(palpate("plan", *given, "--json", cwd=folder))["format"] == "palpate/grip@1"


def test_a_catalogue_is_made_shown_and_studied_by_several_processes(folder: Path) -> None:
    (folder / "parts").mkdir()
    for name in ("plate.svg", "hälfte.svg"):
        (folder / "parts" / name).write_text(PLATE.replace("V15", f"V{len(name)}"), encoding="utf-8")
    palpate(
        "objects", "import", "parts", "--thickness", 20, "--heights", 10, "--out", "made.json", cwd=folder
    )
    assert "hälfte" in palpate("objects", "list", "made.json", cwd=folder)
    palpate("objects", "show", "made.json", cwd=folder)
    assert json.loads(palpate("objects", "check", "made.json", "--json", cwd=folder))
    asked = ("--objects", "made.json", "--runs", 2, "--budget", 0, "--workers", 2, "--keep", "runs.jsonl")
    assert json.loads(palpate("study", *asked, "--report", "study.html", "--json", cwd=folder))


def test_a_drawing_that_is_none_is_refused(folder: Path) -> None:
    (folder / "broken.svg").write_bytes(b"\0" * 100)
    refused = python("-m", "palpate", "objects", "import", "broken.svg", cwd=folder)
    assert (refused.code, "broken.svg" in refused.err, "Traceback" in refused.err) == (2, True, False)


def test_files_are_written_for_a_new_rig(folder: Path) -> None:
    assert json.loads(palpate("schema", "rig", cwd=folder))["title"] == "RigFile"
    palpate("init", "--bench", "xl330-bench", "--out", "mine.toml", cwd=folder)
    assert "ports" in json.loads(palpate("emulate", "--tcp", "--for", 0.1, "--rig", "mine.toml", cwd=folder))


@pytest.mark.parametrize("words", [("emulate",), ("identify", "--view")])
def test_what_is_not_there_is_refused_in_a_line(folder: Path, words: tuple[str, ...]) -> None:
    refused = python("-m", "palpate", *words, cwd=folder)
    assert refused.code in (2, 3)
    assert refused.err.count("\n") == 1


SEAMS = """
import signal, sys, threading, time
from pathlib import Path
import numpy as np
from palpate.base.array_cache import Cache
from palpate.base.confined_reading import read_confined
from palpate.base.errors import InputError
from palpate.rig.session.log_file import LogFile, is_written_now
from palpate.rig.session.signals import HeldInterrupts, INTERRUPTS, Interrupted

cache = Cache(Path("cache").resolve())
cache.keep("kind", "key", {"a": np.arange(4.0)})
assert cache.fetch("kind", "key")["a"].tolist() == [0, 1, 2, 3]

path = Path("session.jsonl.zst")
log = LogFile(path)
log.write("first\\n")
assert is_written_now(path)
assert path.read_bytes(), "a lock keeps nobody from reading"
try:
    LogFile(path)
    raise AssertionError("locked twice")
except BlockingIOError:
    pass
log.write("second\\n")
log.close()
assert not is_written_now(path)

assert {INTERRUPTS[number] for number in INTERRUPTS} == {"interrupted", "terminated"}
assert str(Interrupted.of("hung_up")) == "hung_up", "recorded on another system"

class Told(Exception):
    pass

def tell(number, frame):
    raise Told

signal.signal(signal.SIGTERM, tell)
try:
    with HeldInterrupts():
        signal.raise_signal(signal.SIGTERM)
        end = time.monotonic() + 30
        while time.monotonic() < end:
            pass
    raise AssertionError("not interrupted")
except Told:
    assert time.monotonic() < end

if __name__ == "__main__":
    try:
        read_confined("a.svg", "try another", divmod, 1, 0)
    except InputError as error:
        print(error)
"""


def test_locks_caches_interrupts_and_confined_readings(tmp_path: Path) -> None:
    (tmp_path / "seams.py").write_text(SEAMS, encoding="utf-8")
    done = python("seams.py", cwd=tmp_path)
    assert (done.err, "ZeroDivisionError" in done.out) == ("", True)
