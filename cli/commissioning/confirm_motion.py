"""Asking a person whether fingers may move, before they do. For commands that measure a rig."""

import sys

from rich.console import Console

from palpate.errors import InputError

__all__ = ["ask_to_move", "check_terminal"]

_CLEAR = "Is the table clear, and are hands away?"


def ask_to_move(console: Console, ready: str = _CLEAR) -> None:
    """Ask whether fingers may move: `ready`, a question. InputError unless the answer is yes."""
    check_terminal()
    answer = console.input(f"Fingers are going to move. {ready} \\[y/N] ")
    if answer.strip().lower() not in ("y", "yes"):
        raise InputError("nothing was moved: the question was not answered with yes")


def check_terminal() -> None:
    """Raise InputError if there is no terminal to ask on."""
    if not sys.stdin.isatty():
        raise InputError(
            "fingers are going to move, and there is no terminal to ask on: say --yes if they may"
        )
