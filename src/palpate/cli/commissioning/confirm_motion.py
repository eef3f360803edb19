"""Asking a person whether fingers may move, before they do. For commands that measure a rig."""

from rich.console import Console

from palpate.base.errors import InputError
from palpate.cli.terminal import check_can_ask

__all__ = ["ask_to_move", "check_can_ask_to_move"]

_CLEAR = "Is the table clear, and are hands away?"


def ask_to_move(console: Console, ready: str = _CLEAR) -> None:
    """Ask whether fingers may move: `ready`, a question. InputError unless the answer is yes."""
    check_can_ask_to_move()
    answer = console.input(f"Fingers are going to move. {ready} \\[y/N] ")
    if answer.strip().lower() not in ("y", "yes"):
        raise InputError("nothing was moved: the question was not answered with yes")


def check_can_ask_to_move() -> None:
    """Raise InputError if there is no terminal to ask on. For commands that do much before they ask."""
    check_can_ask("fingers are going to move", "say --yes if they may")
