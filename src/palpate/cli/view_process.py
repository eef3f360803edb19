"""The live view beside a run: a process of its own, so that nothing it does can slow the run."""

import importlib.util
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from palpate.base.errors import InputError
from palpate.base.optional_imports import MissingPackageError, install_command

__all__ = ["view_starter"]


def view_starter(port: int) -> Callable[[Path], None]:
    """What shows the session in a folder, beside the run that records it.

    Raises InputError, before anything moves, if the extra `view` is not installed or the port is taken.
    """
    if any(importlib.util.find_spec(name) is None for name in ("starlette", "uvicorn")):
        raise MissingPackageError(f"--view needs starlette and uvicorn: {install_command('view')}")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            reason = os.strerror(error.errno or 0)
            raise InputError(f"--view-port {port} cannot be served: {reason}; choose another") from None
    return partial(_start_view, port)


def _start_view(port: int, session: Path) -> None:
    """Start showing the session that this process records; the view says its address on stderr.

    It ends by itself after this process, once the page has the last frame and a stop is confirmed.
    """
    words = ["view", str(session), "--port", str(port), "--run", str(os.getpid())]
    subprocess.Popen(  # it is not waited for
        [sys.executable, "-m", "palpate", *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for the run
    )
