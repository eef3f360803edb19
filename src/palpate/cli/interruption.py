"""What an interrupted command leaves behind, said with the interruption."""

from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["if_interrupted"]


@contextmanager
def if_interrupted(note: str) -> Iterator[None]:
    """Add `note` to an interruption that says nothing yet; errors say themselves what they leave behind."""
    try:
        yield
    except Exception:
        raise
    except BaseException as interruption:
        if not getattr(interruption, "__notes__", ()):
            interruption.add_note(note)
        raise
