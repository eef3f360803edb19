"""What `palpate check` found, as tables for a terminal. From a `CheckOut` to rich."""

from collections.abc import Collection

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from palpate.config.check_result import ArrayCheckOut, CheckOut, LoopOut, ServoCheckOut
from palpate.rig.answer_words import counted

__all__ = ["show"]

_FINE, _WARNING, _WRONG = "[green]✓[/]", "[yellow]![/]", "[red]✗[/]"
_UNKNOWN = "[dim]–[/]"


def show(out: CheckOut, console: Console) -> None:
    """Tables of servos and arrays, a line each for bus and adapter, then what is wrong, and a verdict."""
    kind = " (emulated)" if out.emulated else ""
    console.print(f"rig [bold]{escape(out.rig)}[/]{kind}\n", highlight=False)
    console.print(_servos(out.servos))
    console.print()
    console.print(_arrays(out.arrays))
    console.print()
    console.print(_bus_table(out))
    for problem in out.problems:
        console.print(f"{_WRONG} {escape(problem)}", highlight=False)
    for warning in out.warnings:
        console.print(f"{_WARNING} {escape(warning)}", highlight=False)
    if any(item.settings for item in out.servos):
        console.print(
            "  a run writes these settings before anything moves; `palpate setup-motors` writes them now",
            highlight=False,
        )
    console.print(_verdict(out), highlight=False)


def _servos(servos: tuple[ServoCheckOut, ...]) -> Table:
    table = _table(
        ("servo", "firmware"),
        "",
        "servo",
        "",
        "model",
        "firmware",
        "supply",
        "temperature",
        "torque",
        "settings",
    )
    for item in servos:
        table.add_row(
            _mark(item.problems, item.warnings),
            str(item.id),
            escape(item.owner),
            item.model,
            _or(item.firmware, "{}"),
            _supply(item),
            _temperature(item),
            _UNKNOWN if item.torque_on is None else "[red]on[/]" if item.torque_on else "off",
            _settings(item),
        )
    return table


def _arrays(arrays: tuple[ArrayCheckOut, ...]) -> Table:
    table = _table(("lost",), "", "array", "taxels", "frames/s", "lost", "firmware")
    for item in arrays:
        taxels = _UNKNOWN if item.rows is None else f"{item.rows} × {item.columns}"
        rate = _UNKNOWN if item.rate_hz is None else f"{item.rate_hz:.0f} of {item.wanted_hz:g}"
        table.add_row(
            _mark(item.problems, item.warnings),
            escape(item.finger),
            taxels,
            rate,
            _or(item.lost, "{}"),
            _UNKNOWN if item.firmware is None else escape(item.firmware),
        )
    return table


def _bus_table(out: CheckOut) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="bold")
    table.add_column()
    timer = out.adapter.latency_timer_ms
    adapter = f"{out.adapter.port} at {out.adapter.baudrate_bps} baud"
    known = "latency timer not known" if timer is None else f"latency timer {timer:g} ms"
    table.add_row("bus", escape(adapter if out.emulated and timer is None else f"{adapter}, {known}"))
    if out.loop is not None:
        table.add_row("loop", _loop(out.loop))
    counts = out.bus
    lost = f"{counts.damaged} damaged, {counts.silent} silent, {counts.retries} asked again"
    table.add_row("traffic", f"{counts.instructions} instructions: {lost}\n")
    return table


def _loop(loop: LoopOut) -> str:
    how = "fast sync read" if loop.fast else "sync read"
    return (
        f"{loop.rate_hz:.0f} Hz: {counted(loop.servos, 'servo', 'servos')} in {loop.median_ms:.2f} ms, 99 % "
        f"within {loop.p99_ms:.2f} ms ({how}; the wire alone takes {loop.wire_ms:.2f} ms)"
    )


def _verdict(out: CheckOut) -> str:
    warnings = counted(len(out.warnings), "warning", "warnings")
    if out.problems:
        things = counted(len(out.problems), "thing is", "things are")
        return f"[red bold]{things} wrong[/]" + (f", {warnings}" if out.warnings else "")
    return f"[green bold]nothing is wrong[/], {warnings}" if out.warnings else "[green bold]all well[/]"


def _table(numbers: Collection[str], *columns: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in columns:
        table.add_column(name, justify="right" if name in numbers else "left")
    return table


def _mark(problems: tuple[str, ...], warnings: tuple[str, ...]) -> str:
    return _WRONG if problems else _WARNING if warnings else _FINE


def _or(value: int | None, form: str) -> str:
    return _UNKNOWN if value is None else form.format(value)


def _supply(item: ServoCheckOut) -> str:
    if item.voltage_v is None or item.voltage_limits_v is None:
        return _UNKNOWN
    low, high = item.voltage_limits_v
    colour = "" if low <= item.voltage_v <= high else "[red]"
    return f"{colour}{item.voltage_v:.1f} V{'[/]' if colour else ''} [dim]({low:.1f} … {high:.1f})[/]"


def _temperature(item: ServoCheckOut) -> str:
    if item.temperature_c is None or item.temperature_limit_c is None:
        return _UNKNOWN
    colour = "" if item.temperature_c < item.temperature_limit_c else "[red]"
    return (
        f"{colour}{item.temperature_c} °C{'[/]' if colour else ''} [dim](below {item.temperature_limit_c})[/]"
    )


def _settings(item: ServoCheckOut) -> str:
    if not item.answers:
        return _UNKNOWN
    return f"[yellow]{len(item.settings)} to write[/]" if item.settings else "as wanted"
