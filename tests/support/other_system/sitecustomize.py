"""Hides from palpate, in a process that has this folder on its path, what Windows and macOS lack.

From palpate's own modules alone: the standard library and other packages take a branch of their own on those
systems, which this interpreter does not have. Processes are spawned, not forked; text files that are opened
without an encoding are an error; standard streams have the encoding that the environment says.
"""

import builtins
import fcntl
import multiprocessing
import os
import signal
import struct
import sys
import types
import warnings
from typing import Any

OURS = {"palpate", "palpate_weiss"}
MODULES = {"fcntl", "termios", "tty", "pty", "resource", "grp", "pwd", "posix", "syslog"}
NAMES = {
    "signal": {
        *("SIGHUP", "SIGUSR1", "SIGUSR2", "SIGXCPU", "SIGKILL", "SIGALRM", "SIGPROF", "SIGPIPE", "SIGCHLD"),
        *("pthread_kill", "pthread_sigmask", "alarm", "setitimer", "sigwait"),
    },
    "os": {
        *("geteuid", "getuid", "getegid", "getgid", "getgroups", "getpgid", "getpgrp", "setsid", "setpgid"),
        *("tcgetpgrp", "killpg", "fork", "forkpty", "openpty", "ttyname", "sched_getaffinity", "nice"),
        *("fchmod", "chown", "uname", "mkfifo", "wait", "O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC"),
    },
}


def kill(number: int, how: int) -> None:
    """Complain: on Windows this ends a process at once, whatever the signal."""
    raise AssertionError(f"os.kill({number}, {how})")


def locking(number: int, mode: int, count: int) -> None:
    """Lock bytes from a file's position on against its other openings, as Windows does, or unlock them."""
    readable = fcntl.fcntl(number, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY
    kind = fcntl.F_UNLCK if mode == LK_UNLCK else fcntl.F_RDLCK if readable else fcntl.F_WRLCK
    place = os.lseek(number, 0, os.SEEK_CUR)
    try:
        fcntl.fcntl(number, fcntl.F_OFD_SETLK, struct.pack("hhqqi4x", kind, os.SEEK_SET, place, count, 0))
    except BlockingIOError as error:
        raise PermissionError(error.errno, error.strerror) from None


LK_UNLCK, LK_NBLCK = 0, 2
MSVCRT = types.SimpleNamespace(locking=locking, LK_UNLCK=LK_UNLCK, LK_NBLCK=LK_NBLCK)
ANSWERS = {("os", "name"): "nt", ("os", "kill"): kill}


def is_ours(scope: dict[str, Any] | None) -> bool:
    """Return whether code with these globals is a module of palpate, or one that is run as a script."""
    scope = scope or {}
    spec = scope.get("__spec__")
    return (spec.name if spec is not None else scope.get("__name__", "")).partition(".")[0] in OURS


class Hidden(types.ModuleType):
    """A module some of whose names palpate does not see."""

    def __getattribute__(self, name: str) -> Any:
        module = super().__getattribute__("__name__")
        if (name in NAMES[module] or (module, name) in ANSWERS) and is_ours(sys._getframe(1).f_globals):
            if (module, name) in ANSWERS:
                return ANSWERS[module, name]
            raise AttributeError(f"module {module!r} has no attribute {name!r}", name=name, obj=self)
        return super().__getattribute__(name)


def hiding_import(name: str, scope: Any = None, *rest: Any, **named: Any) -> Any:
    """Import as ever, but for what is hidden."""
    if name in MODULES and is_ours(scope):
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)
    if name == "msvcrt" and is_ours(scope):
        return MSVCRT
    return import_as_ever(name, scope, *rest, **named)


import_as_ever = builtins.__import__
builtins.__import__ = hiding_import
for module in (os, signal):
    module.__class__ = Hidden
multiprocessing.set_start_method("spawn", force=True)
warnings.filterwarnings("ignore", category=EncodingWarning)
warnings.filterwarnings("error", category=EncodingWarning, module=r"palpate")
