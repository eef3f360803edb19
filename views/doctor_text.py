"""The result of `palpate doctor` on the terminal: a line for each step, and what is wrong beneath it."""

from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from palpate.config.doctor_result import DoctorOut, DoctorStepOut, FindingOut, Outcome, Severity
from palpate.errors import counted

__all__ = ["show"]

_MARKS = {
    Outcome.WELL: "[green]✓[/]",
    Outcome.WARNING: "[yellow]![/]",
    Outcome.WRONG: "[red]✗[/]",
    Outcome.SKIPPED: "[dim]–[/]",
}
_NAME_WIDTH = 20
_INDENT = 4


def show(out: DoctorOut, console: Console, *, verbose: bool = False) -> None:
    """All steps with their findings, then how it is, and the one next thing to do.

    `verbose`: also what each step looked at.
    """
    kind = " (emulated)" if out.emulated else ""
    console.print(f"rig [bold]{escape(out.rig)}[/]{kind}\n", highlight=False)
    for item in _gathered(out.steps):
        _print_step(item, console, wide=verbose)
    console.print()
    console.print(_verdict(out), highlight=False)
    if out.next is not None:
        console.print(_row("next", f"[bold]{escape(out.next)}[/]"), highlight=False)


def _gathered(steps: tuple[DoctorStepOut, ...]) -> list[DoctorStepOut]:
    """Steps that follow each other and were skipped for the same reason, in one line."""
    gathered: list[DoctorStepOut] = []
    for item in steps:
        last = gathered[-1] if gathered else None
        both = last is not None and {last.outcome, item.outcome} == {Outcome.SKIPPED}
        if last is not None and both and last.skipped_because == item.skipped_because:
            gathered[-1] = last.model_copy(update={"step": f"{last.step}, {item.step}"})
        else:
            gathered.append(item)
    return gathered


def _print_step(item: DoctorStepOut, console: Console, *, wide: bool) -> None:
    saw = escape(item.saw)
    if item.outcome is Outcome.SKIPPED:
        saw = f"[dim]skipped: {escape(item.skipped_because or '')}[/]"
    looked = f"[dim]{escape(item.looked_at)}:[/] " if wide else ""
    line = Table.grid(padding=(0, 1))
    line.add_column(width=1)
    line.add_column(width=_NAME_WIDTH)
    line.add_column(overflow="fold")
    line.add_row(_MARKS[item.outcome], escape(item.step), looked + saw)
    console.print(line, highlight=False)
    for found in item.findings:
        _print_finding(found, console)


def _print_finding(found: FindingOut, console: Console) -> None:
    colour = "red" if found.severity is Severity.WRONG else "yellow"
    head = f"[{colour}]{escape(found.device)}[/]: {escape(found.saw)}"
    console.print(Padding(head, (0, 0, 0, _INDENT)), highlight=False)
    console.print(Padding(_row("means", escape(found.means)), (0, 0, 0, _INDENT)), highlight=False)
    console.print(Padding(_row("do", f"[bold]{escape(found.next)}[/]"), (0, 0, 0, _INDENT)), highlight=False)


def _row(name: str, text: str) -> Table:
    row = Table.grid(padding=(0, 1))
    row.add_column(width=5, style="dim")
    row.add_column(overflow="fold")
    row.add_row(name, text)
    return row


def _verdict(out: DoctorOut) -> str:
    serious = sum(item.severity is Severity.WRONG for item in out.findings)
    mild = len(out.findings) - serious
    warnings = counted(mild, "warning", "warnings")
    if serious:
        things = counted(serious, "thing is", "things are")
        return f"[red bold]{things} wrong[/]" + (f", {warnings}" if mild else "")
    return f"[green bold]nothing is wrong[/], {warnings}" if mild else "[green bold]all well[/]"
