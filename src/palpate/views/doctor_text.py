"""The result of `palpate doctor` on the terminal: a line for each step, and what is wrong beneath it."""

from rich.console import Console, RenderableType
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from palpate.base.errors import counted
from palpate.config.doctor_result import DoctorOut, DoctorStepOut, FindingOut, Outcome, Severity

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
    if item.outcome is Outcome.SKIPPED:
        text = f"[dim]{escape(item.step)}: skipped, {escape(item.skipped_because or '')}[/]"
        console.print(_columns((_MARKS[item.outcome], 1), (text, None)), highlight=False)
        return
    looked = f"[dim]{escape(item.looked_at)}:[/] " if wide else ""
    cells = (_MARKS[item.outcome], 1), (escape(item.step), _NAME_WIDTH), (looked + escape(item.saw), None)
    console.print(_columns(*cells), highlight=False)
    for found in _alike(item.findings):
        _print_findings(found, console)


def _alike(findings: tuple[FindingOut, ...]) -> list[list[FindingOut]]:
    """Findings that follow each other and mean the same together: that is said once."""
    groups: list[list[FindingOut]] = []
    for item in findings:
        before = groups[-1][0] if groups else None
        if before is not None and (before.means, before.next) == (item.means, item.next):
            groups[-1].append(item)
        else:
            groups.append([item])
    return groups


def _print_findings(alike: list[FindingOut], console: Console) -> None:
    for found in alike:
        colour = "red" if found.severity is Severity.WRONG else "yellow"
        _print_indented(f"[{colour}]{escape(found.device)}[/]: {escape(found.saw)}", console)
    _print_indented(_row("means", escape(alike[0].means)), console)
    _print_indented(_row("do", f"[bold]{escape(alike[0].next)}[/]"), console)


def _print_indented(what: RenderableType, console: Console) -> None:
    console.print(Padding(what, (0, 0, 0, _INDENT)), highlight=False)


def _row(name: str, text: str) -> Table:
    return _columns((f"[dim]{name}[/]", 5), (text, None))


def _columns(*cells: tuple[str, int | None]) -> Table:
    """Texts side by side, of given widths; the last one folds."""
    row = Table.grid(padding=(0, 1))
    for _, width in cells:
        row.add_column(width=width, overflow="fold")
    row.add_row(*(text for text, _ in cells))
    return row


def _verdict(out: DoctorOut) -> str:
    serious = sum(item.severity is Severity.WRONG for item in out.findings)
    mild = len(out.findings) - serious
    warnings = counted(mild, "warning", "warnings")
    if serious:
        things = counted(serious, "thing is", "things are")
        return f"[red bold]{things} wrong[/]" + (f", {warnings}" if mild else "")
    return f"[green bold]nothing is wrong[/], {warnings}" if mild else "[green bold]all well[/]"
