"""How a command ends: exit codes, and the interrupt that a signal becomes. Beneath the command line."""

from enum import IntEnum

__all__ = ["ExitCode", "Interrupted"]


class ExitCode(IntEnum):
    """What a command's end tells its caller."""

    DONE = 0
    NOT_RESOLVED = 1
    INPUT = 2
    DEVICE = 3
    SAFETY = 4
    OUTPUT = 5
    HUNG_UP = 129
    INTERRUPTED = 130
    TERMINATED = 143


class Interrupted(BaseException):
    """A signal asked the process to end; carries the exit code that says which.

    Not a KeyboardInterrupt: typer makes one code of all of those.
    """

    def __init__(self, code: ExitCode) -> None:
        super().__init__(code.name.lower())
        self.code = code
