"""Result of `palpate export`: `palpate/export@1`."""

from typing import Literal

from palpate.config.results import Out

__all__ = ["ExportOut", "ExportedOut"]


class ExportedOut(Out):
    """A file or folder that was written, and how many messages are on each topic (lines in each CSV file)."""

    path: str
    messages: dict[str, int]


class ExportOut(Out):
    """What was written of a session."""

    format: Literal["palpate/export@1"] = "palpate/export@1"
    session: str
    written: tuple[ExportedOut, ...]
