"""The process that `confined` starts: a pickled call on standard input, its outcome on standard output."""

import os
import pickle
import resource
import sys

from palpate.base.errors import InputError
from palpate.base.files.confined import TOO_LARGE
from palpate.base.files.limits import READING_BYTES, READING_S

__all__ = ["main"]

_SPARE_BYTES = 32_000_000
"""Of memory: with which to say that there is no more."""


def main() -> int:
    """Carry out the call within the limits."""
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as out:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # OpenCASCADE writes to standard output
        call = sys.stdin.buffer.read()
        resource.setrlimit(resource.RLIMIT_CPU, (int(READING_S), int(READING_S) + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (READING_BYTES, READING_BYTES))
        resource.setrlimit(resource.RLIMIT_DATA, (READING_BYTES - _SPARE_BYTES, READING_BYTES))
        answer = _answer(call)
        resource.setrlimit(resource.RLIMIT_DATA, (READING_BYTES, READING_BYTES))
        out.write(pickle.dumps(answer))
    return 0


def _answer(call: bytes) -> tuple[str, object]:
    try:
        read, args, kwargs = pickle.loads(call)
        return "value", read(*args, **kwargs)
    except InputError as error:
        return "refused", (str(error), *getattr(error, "__notes__", ()))
    except MemoryError:
        return "failed", TOO_LARGE
    except Exception as error:
        what = " ".join(f"{type(error).__name__}: {error}".split())
        return "failed", f"cannot be read ({what:.200})"


if __name__ == "__main__":
    sys.exit(main())
