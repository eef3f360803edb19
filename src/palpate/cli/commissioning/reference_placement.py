"""A person at the table, asked on the terminal to put references where calibration wants them."""

from rich.console import Console
from rich.markup import escape

from palpate.base.errors import InputError
from palpate.calibration.reference import Reference

__all__ = ["ConsoleTable"]


class ConsoleTable:
    """Asks for each change on the table and waits for Enter."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._empty = False

    def put(self, reference: Reference, about_mm: tuple[float, float]) -> None:
        """Ask for a reference near a place; raises InputError if standard input has ended."""
        x, y = about_mm
        where = "in the middle" if x == y == 0 else f"near x {x:.0f}, y {y:.0f} mm"
        turned = ", turned as you like" if reference.turns else ""
        self._ask(f"Put the {reference.name} {where}{turned}; alone, and so that it cannot slide.")
        self._empty = False

    def clear(self) -> None:
        """Ask for an empty table, once."""
        if not self._empty:
            self._ask("Clear the table: nothing may lie in the fingers' way.")
        self._empty = True

    def _ask(self, what: str) -> None:
        try:
            self._console.input(f"[bold]{escape(what)}[/bold] Then keep your hands away and press Enter. ")
        except EOFError:
            raise InputError(
                "references cannot be put on the table: standard input has ended; use a terminal"
            ) from None
