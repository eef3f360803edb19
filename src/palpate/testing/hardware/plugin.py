"""Pytest plugin of the hardware tests: options, skipping without a rig, confirmation before motion, figures.

Not an entry point: it would put these options into every pytest run of an environment with palpate in it.
"""

import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from palpate.base.errors import InputError
from palpate.config import RigOnBench, load_calibrated, load_objects, shipped_objects
from palpate.rig.session.signals import INTERRUPTS

RIG = pytest.StashKey[RigOnBench]()
"""In a config's stash: the rig under test, if `--rig` names one."""

_FOLDER = Path(__file__).parent
_NO_RIG = "needs a rig: --rig FILE"
_NO_PART = "needs a part on the table: --part NAME"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("hardware", "tests of a real rig")
    group.addoption("--rig", metavar="FILE", help="rig file (TOML) of the rig under test")
    group.addoption("--yes-move", action="store_true", help="fingers may move, do not ask")
    group.addoption("--part", metavar="NAME", help="this part lies on the table: identify it, too")
    group.addoption("--objects", metavar="FILE", help="with --part: object models; else the shipped ones")


def pytest_configure(config: pytest.Config) -> None:
    """Read the rig file; without paths of its own, a run with `--rig` is one of these tests alone."""
    config.addinivalue_line("markers", "moves(what): torque goes on, and this moves; asked for beforehand")
    config.addinivalue_line("markers", "needs_part: only with `--part`")
    file = config.getoption("rig")
    if file is None:
        return
    try:
        rig = load_calibrated(Path(file))
        _check_part(config.getoption("part"), config.getoption("objects"))
    except InputError as error:
        raise pytest.UsageError("\n".join([str(error), *getattr(error, "__notes__", ())])) from error
    if rig.described.emulated:
        raise pytest.UsageError(
            f'rig "{rig.rig.name}" has no ports of its own: serve its devices with '
            f"`palpate emulate --rig {file} --rig-out served.toml`, and test served.toml"
        )
    if hasattr(config, "workerinput") or getattr(config.option, "numprocesses", None):
        raise pytest.UsageError("one rig cannot be tested by several processes: leave -n out")
    for number in INTERRUPTS:  # as Ctrl-C does: torque off, and the session ends
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)
    config.stash[RIG] = rig
    if config.args_source is not pytest.Config.ArgsSource.ARGS:
        config.args = [str(_FOLDER)]


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip what needs a rig, or a part, if there is none."""
    for item in items:
        if not item.path.is_relative_to(_FOLDER):
            continue
        if RIG not in config.stash:
            item.add_marker(pytest.mark.skip(reason=_NO_RIG))
        elif item.get_closest_marker("needs_part") and config.getoption("part") is None:
            item.add_marker(pytest.mark.skip(reason=_NO_PART))


def ask_to_move(config: pytest.Config, name: str, what: str) -> None:
    """Say what moves, and ask whether it may. Skips the test unless the answer is yes.

    `--yes-move` answers yes. Without it and without a terminal nothing can be asked.
    """
    capture = config.pluginmanager.get_plugin("capturemanager")
    assert capture is not None, "it comes with pytest"
    capture.suspend_global_capture(in_=True)
    try:
        sys.stdout.write(f"\n{name} moves: {what}\n")
        if config.getoption("yes_move"):
            return
        if not sys.stdin.isatty():
            pytest.skip(f"moves ({what}), and there is no terminal to ask on: --yes-move if it may")
        sys.stdout.write("Are hands away, and may it? [y/N] ")
        sys.stdout.flush()
        if sys.stdin.readline().strip().lower() not in ("y", "yes"):
            pytest.skip(f"moves ({what}), and the question was not answered with yes")
    finally:
        sys.stdout.flush()
        capture.resume_global_capture()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print the figures, which `--junitxml` has as properties."""
    if RIG not in config.stash:
        return
    reports = [
        report
        for kind in ("passed", "failed", "error", "skipped")
        for report in terminalreporter.stats.get(kind, [])
        if getattr(report, "user_properties", None)
    ]
    if reports:
        terminalreporter.section("figures")
    said: set[str] = set()
    for report in reports:
        if report.nodeid not in said:
            said.add(report.nodeid)
            figures = ", ".join(f"{name} {value}" for name, value in report.user_properties)
            terminalreporter.write_line(f"{report.nodeid.rpartition('::')[2]}: {figures}")


def _check_part(part: str | None, objects: str | None) -> None:
    """Raise InputError for a part that is not in the catalogue."""
    if part is None:
        if objects is not None:
            raise InputError("--objects is for --part: say which of them lies on the table")
        return
    names: Sequence[str] = [
        item.name for item in load_objects(Path(objects) if objects else shipped_objects()).objects
    ]
    if part not in names:
        raise InputError(f'--part: no object is called "{part}"; there are {", ".join(names)}')
