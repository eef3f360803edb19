"""Display of a run: its progress and answer on the terminal, and the live view in the browser.

The view is a separate process, so that it cannot slow the run.
"""

import importlib.util
import math
import os
import socket
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.padding import Padding

from palpate.base.errors import InputError, MissingPackageError, quantity
from palpate.base.optional_imports import install_command
from palpate.cli.terminal import StatusLine
from palpate.jobs.recognition import Answer
from palpate.recognizer import Recognition
from palpate.rig.identification.events import (
    Event,
    MoveEvent,
    PlanEvent,
    RecognitionEvent,
    StageEvent,
    TouchEvent,
)

_MAX_NAMES = 5


class IdentificationProgress(StatusLine):
    """Progress of a run on stderr: a line for each grip, and a moving line on a terminal."""

    def __init__(self, console: Console) -> None:
        super().__init__(console, "connecting")

    def __call__(self, event: Event) -> None:
        """Show an event."""
        match event:
            case StageEvent(grip, stage):
                self.now(f"grip {grip}: {stage.value}")
            case PlanEvent(grip, plan, reason):
                self._print_under(f"next {reason}")
                self.now(f"grip {grip}: planned{', decisive' if plan.decisive else ''}")
            case TouchEvent(grip, touches):
                contacts = [touch.contact for touch in touches]
                each = (f"{item.name} {'touched' if item.touched else 'missed'}" for item in contacts)
                self.console.print(f"grip {grip}: {', '.join(each)}")
            case RecognitionEvent(_, recognition, _, None):
                self._print_under(_hypotheses(recognition))
            case RecognitionEvent(_, recognition, others, divisions):
                for number, part in enumerate((recognition, *others), start=1):
                    self._print_under(f"part {number}, {_hypotheses(part)}")
                if divisions is not None and divisions > 1:
                    self._print_under(f"{divisions} ways to divide the touches among parts")
            case MoveEvent(_, float() as furthest_mm):
                far = f"by {furthest_mm:.1f} mm" if math.isfinite(furthest_mm) else "without a bound"
                self._print_under(f"fingers may have moved the part {far}: earlier grips are dropped")
            case MoveEvent():
                self._print_under("contradicts earlier grips: the part may have moved, they are dropped")

    def _print_under(self, words: str) -> None:
        """Print below a grip, indented."""
        self.console.print(Padding(words, (0, 0, 0, 8), expand=False))


def _hypotheses(recognition: Recognition) -> str:
    """Number of hypotheses left, and the first of their objects' names."""
    names = [item.state.object_name for item in recognition.hypotheses]
    distinct = list(dict.fromkeys(names))
    shown = ", ".join(distinct[:_MAX_NAMES])
    more = f" and {len(distinct) - _MAX_NAMES} more" if len(distinct) > _MAX_NAMES else ""
    return f"{quantity(len(names), 'hypothesis', 'hypotheses')}{': ' if names else ''}{shown}{more}"


def closing_lines(answer: Answer, picture: Path) -> list[str]:
    """The answer for a person, a paragraph each."""
    out = answer.result
    return [
        answer.text(),
        f"{quantity(out.grips, 'grip', 'grips')}, {quantity(out.touches, 'touch', 'touches')}, "
        f"{out.rig_seconds:.1f} s on the {'emulated ' if out.emulated else ''}rig, "
        f"{out.wall_seconds:.1f} s here",
        f"picture {picture}, session {out.session}",
    ]


Starter = Callable[[Path], None]
"""Shows the session in a folder, beside the run that records it."""


def view_starter(port: int) -> Starter:
    """Return what shows a session on a page.

    Raises InputError, before anything moves, if the extra `view` is not installed, the port is taken, or the
    system would neither end the view with the run nor let it interrupt the run.
    """
    _check_follower("--view", "view", ("starlette", "uvicorn"))
    _check_port("--view-port", port)
    return partial(_start_follower, ["--port", str(port)])


def foxglove_starter(port: int) -> Starter:
    """Return what serves a session to Foxglove; errors as of `view_starter`."""
    _check_follower("--foxglove", "export", ("foxglove",))
    _check_port("--foxglove-port", port)
    return partial(_start_follower, ["--foxglove", "--port", str(port)])


def ros_starter(address: str) -> Starter:
    """Return what publishes a session to a rosbridge; errors as of `view_starter`, and if none answers."""
    _check_follower("--ros", "ros", ("rosbags", "websockets"))
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal():
        raise InputError(f"--ros {address}: is no HOST:PORT, such as localhost:9090")
    try:
        socket.create_connection((host, int(port)), timeout=_ANSWER_S).close()
    except OSError as error:
        raise InputError(
            f"--ros {address}: no rosbridge answers ({error.strerror or error}); start it with "
            "ros2 launch rosbridge_server rosbridge_websocket_launch.xml"
        ) from None
    return partial(_start_follower, ["--ros", address])


_ANSWER_S = 3.0


def _check_follower(option: str, extra: str, modules: Sequence[str]) -> None:
    if os.name == "nt":
        raise InputError(f"{option} is not for Windows: palpate view SESSION, in another terminal, follows")
    if any(importlib.util.find_spec(name) is None for name in modules):
        raise MissingPackageError(f"{option} needs {' and '.join(modules)}: {install_command(extra)}")


def _check_port(option: str, port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            reason = os.strerror(error.errno or 0)
            raise InputError(f"{option} {port} cannot be served: {reason}; choose another") from None


def _start_follower(options: Sequence[str], session: Path) -> None:
    """Start showing the session that this process records; it says its address on stderr.

    It ends by itself after this process, once the page has the last frame and a stop is confirmed.
    """
    words = ["view", str(session), *options, "--run", str(os.getpid())]
    subprocess.Popen(  # it is not waited for
        [sys.executable, "-m", "palpate", *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for the run
    )
