"""What holds for every test: reproducible properties, and nothing left running behind a test."""

import fcntl
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from support.benches.rigs import RUNS
from support.commands.command import Here, run_here

PROCESSOR_S = 600.0

os.environ["PALPATE_CACHE"] = "off"  # also of commands under test: what was kept must not decide a test

settings.register_profile("reproducible", derandomize=True, deadline=None)
settings.load_profile("reproducible")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put slow tests first: workers end at the same time if only quick ones are left."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The folder of a session of `support.benches.rigs.RUNS`, which is run once for all workers."""
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own

    def run_of(name: str) -> Path:
        with (shared / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            folder = shared / f"recorded-{name}"
            if not folder.exists():
                made = tmp_path_factory.mktemp(name)
                shutil.copytree(RUNS[name](made), folder)
        return folder

    return run_of


@pytest.fixture(autouse=True, scope="session")
def children_heed_signals() -> Iterator[None]:
    """Signals that nohup or a shell's `&` set to be ignored would stay so in every command under test."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
    ignored = [number for number in numbers if signal.getsignal(number) is signal.SIG_IGN]
    for number in ignored:
        signal.signal(number, lambda *_: None)  # handlers, unlike SIG_IGN, do not outlive exec
    yield
    for number in ignored:
        signal.signal(number, signal.SIG_IGN)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Here:
    """The command's entry point in this process, in a folder of its own and 80 columns."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    return lambda *args: run_here(args, monkeypatch, capsys)


@pytest.fixture
def read_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """CAD files are read in this process; tests of hostile files give each an interpreter, as users do."""
    monkeypatch.setenv("PALPATE_READING_PROCESS", "1")


@pytest.fixture(autouse=True)
def no_thread_is_left_behind() -> Iterator[None]:
    """A test that leaves a thread running would disturb whichever test comes next."""
    before = set(threading.enumerate())
    yield
    left = [thread for thread in threading.enumerate() if thread not in before]
    for thread in left:
        thread.join(timeout=60.0)
    assert [thread.name for thread in left if thread.is_alive()] == []


@pytest.fixture(autouse=True)
def processor_time_is_bounded() -> Iterator[None]:
    """End a test that computes without end, however busy the computer is; one that waits has `timeout`."""

    def give_up(*_: object) -> None:
        pytest.fail(f"{PROCESSOR_S:.0f} s of processor time")

    before = signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, PROCESSOR_S)
    yield
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    signal.signal(signal.SIGPROF, before)
