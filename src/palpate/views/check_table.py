"""The result of `palpate check` as tables on the terminal."""

from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from palpate.base.errors import quantity
from palpate.config.diagnosis_results import (
    ArrayCheckOut,
    BusLoopOut,
    CalibrationCheckOut,
    CheckOut,
    DoctorStepOut,
    FingerHoldOut,
    HoldCheckOut,
    ServoCheckOut,
    TouchCheckOut,
)
from palpate.rig.diagnostics.motion_checks import round_down
from palpate.views.doctor import WIRING_STEP, wiring_words
from palpate.views.tables import folding_column, table

_FINE, _WARNING, _WRONG = "[green]✓[/]", "[yellow]![/]", "[red]✗[/]"
_UNKNOWN = "[dim]–[/]"
_WIDE_COLUMNS = 100  # columns from which limits and protocols are shown, too


def show_check(out: CheckOut, console: Console) -> None:
    """Tables of servos and arrays, a line each for bus and adapter, then what is wrong, and a verdict."""
    kind = " (emulated)" if out.emulated else ""
    console.print(f"rig [bold]{escape(out.rig)}[/]{kind}\n", highlight=False)
    console.print(_servos(out.servos, wide=console.width >= _WIDE_COLUMNS))
    console.print()
    if out.arrays:
        console.print(_arrays(out.arrays, wide=console.width >= _WIDE_COLUMNS))
    else:
        console.print("arrays       none: fingers sense by Present Current")
    console.print()
    for line in [*_bus_lines(out), *_wiring_lines(out.steps)]:
        console.print(line, highlight=False)
    console.print()
    for problem in out.problems:
        console.print(f"{_WRONG} {escape(problem)}", highlight=False)
    for warning in out.warnings:
        console.print(f"{_WARNING} {escape(warning)}", highlight=False)
    console.print(_verdict(out), highlight=False)


def _servos(servos: tuple[ServoCheckOut, ...], *, wide: bool) -> Table:
    columns = (
        folding_column(""),
        "servo",
        folding_column(""),
        "model",
        "firmware",
        "supply",
        "temp.",
        "torque",
        "settings",
    )
    rows = table(*columns, numbers=("servo", "firmware"))
    for item in servos:
        rows.add_row(
            _mark(item.problems, item.warnings),
            str(item.id),
            escape(item.owner),
            item.model,
            _or_unknown(item.firmware, "{}"),
            _supply(item, wide=wide),
            _temperature(item, wide=wide),
            _UNKNOWN if item.torque_on is None else "[red]on[/]" if item.torque_on else "off",
            _settings(item),
        )
    return rows


def _arrays(arrays: tuple[ArrayCheckOut, ...], *, wide: bool) -> Table:
    protocol = ["protocol"] if wide else []
    names = "array", "taxels", "self-test", "frames/s", "lost", *protocol, "firmware"
    rows = table(folding_column(""), *names, numbers=("lost",))
    for item in arrays:
        taxels = _UNKNOWN if item.rows is None else f"{item.rows} × {item.columns} {item.shape}"
        rate = _UNKNOWN if item.rate_hz is None else f"{item.rate_hz:.0f} of {item.wanted_hz:g}"
        rows.add_row(
            _mark(item.problems, item.warnings),
            escape(item.finger),
            taxels,
            _self_test(item),
            rate,
            _or_unknown(item.lost, "{}"),
            *([item.protocol] if wide else []),
            _UNKNOWN if item.firmware is None else escape(item.firmware),
        )
    return rows


def _self_test(item: ArrayCheckOut) -> str:
    if item.bad_taxels is None:
        return _UNKNOWN
    return f"[red]{item.bad_taxels} bad[/]" if item.bad_taxels else "done"


def _bus_lines(out: CheckOut) -> list[str]:
    timer = out.adapter.latency_timer_ms
    known = "latency timer not known" if timer is None else f"latency timer {timer:g} ms"
    adapter = f"{escape(out.adapter.port)} at {out.adapter.baudrate_bps} baud"
    counts = out.bus
    lost = f"{counts.damaged} damaged, {counts.silent} silent, {counts.retries} asked again"
    calibration = "none" if out.calibration is None else _calibration(out.calibration)
    return [
        f"[bold]bus[/]          {adapter}" + ("" if out.emulated and timer is None else f", {known}"),
        *([] if out.loop is None else [f"[bold]loop[/]         {_loop(out.loop)}"]),
        f"[bold]traffic[/]      {counts.instructions} instructions: {lost}",
        f"[bold]calibration[/]  {calibration}",
        f"[bold]touch[/]        presses with {out.touch_force.quick_n:.2g} N when it finds a part, with "
        f"{out.touch_force.slow_n:.2g} N when it measures; a finger that nobody stops, with up to "
        f"{out.touch_force.unstopped_n:.2g} N",
        *([] if out.hold is None else _hold_lines(out.hold)),
    ]


def _wiring_lines(steps: Sequence[DoctorStepOut]) -> list[str]:
    """Line that says what was seen of the wiring, or why nobody looked."""
    found = (item.skipped_because or item.saw for item in steps if item.step == WIRING_STEP)
    return [f"[bold]wiring[/]       {escape(text)}" for text in found]


def _hold_lines(found: HoldCheckOut) -> list[str]:
    fingers = "; ".join(map(_finger_hold, found.fingers))
    end = "" if found.slid else "; no push made it slide for certain"
    return [
        f"[bold]part[/]         holds {found.part_holds_n:g} N at least ({fingers}){end}; moved by "
        f"{found.moved_mm:.1f} mm in all touches together",
        f"             for the rig file, below \\[search]: [bold]part_holds_n = {found.part_holds_n:g}[/]",
    ]


def _finger_hold(item: FingerHoldOut) -> str:
    name = escape(item.finger)
    if item.holds_n is None:
        return f"{name} nothing for certain"
    return f"{name} pushed with {item.pressed_n:.2g} N, of which {round_down(item.holds_n):g} N are certain"


def _calibration(found: CalibrationCheckOut) -> str:
    age = quantity(found.age_days, "day", "days")
    bounds = (
        "without bounds on contacts"
        if found.position_mm is None or found.direction_deg is None
        else f"{100 * found.coverage:.4g} % of contacts within ±{found.position_mm:.3g} mm and "
        f"±{found.direction_deg:.3g}°"
    )
    match = {True: "of these devices", False: "[red]of other devices[/]", None: "devices not known"}
    words = [found.made[:10], f"{age} old", bounds, match[found.devices_match]]
    return ", ".join(words if found.touch is None else [*words, _touch(found.touch)])


def _touch(found: TouchCheckOut) -> str:
    fingers = ", ".join(f"{escape(item.finger)} {item.offset_mm:+.3f}" for item in found.fingers)
    verdict = "agrees" if found.agrees else "[red]does not agree[/]"
    return (
        f"{verdict} with {quantity(found.touches, 'touch', 'touches')} ({fingers} mm; "
        f"{found.residual_rms_mm:.3f} mm rms, {found.expected_rms_mm:.3f} expected){_friction(found)}"
    )


def _friction(found: TouchCheckOut) -> str:
    known = [f"{item.friction_a:.3f}" for item in found.fingers if item.friction_a is not None]
    return f"; slides need {', '.join(known)} A to move freely" if known else ""


def _loop(loop: BusLoopOut) -> str:
    how = "fast sync read" if loop.fast else "sync read"
    return (
        f"{loop.rate_hz:.0f} Hz: {quantity(loop.servos, 'servo', 'servos')} in {loop.median_ms:.2f} ms, 99 % "
        f"within {loop.p99_ms:.2f} ms ({how}; the wire alone takes {loop.wire_ms:.2f} ms)"
    )


def _verdict(out: CheckOut) -> str:
    warnings = quantity(len(out.warnings), "warning", "warnings")
    if out.problems:
        things = quantity(len(out.problems), "thing is", "things are")
        return f"[red bold]{things} wrong[/]" + (f", {warnings}" if out.warnings else "")
    fine = f"[green bold]nothing is wrong[/], {warnings}" if out.warnings else "[green bold]all well[/]"
    return fine + wiring_words(out.steps)


def _mark(problems: tuple[str, ...], warnings: tuple[str, ...]) -> str:
    return _WRONG if problems else _WARNING if warnings else _FINE


def _or_unknown(value: int | None, form: str) -> str:
    return _UNKNOWN if value is None else form.format(value)


def _supply(item: ServoCheckOut, *, wide: bool) -> str:
    if item.voltage_v is None or item.voltage_limits_v is None:
        return _UNKNOWN
    low, high = item.voltage_limits_v
    colour = "" if low <= item.voltage_v <= high else "[red]"
    limits = f" [dim]({low:.1f} … {high:.1f})[/]" if wide else ""
    return f"{colour}{item.voltage_v:.1f} V{'[/]' if colour else ''}{limits}"


def _temperature(item: ServoCheckOut, *, wide: bool) -> str:
    if item.temperature_c is None or item.temperature_limit_c is None:
        return _UNKNOWN
    colour = "" if item.temperature_c < item.temperature_limit_c else "[red]"
    limit = f" [dim](below {item.temperature_limit_c})[/]" if wide else ""
    return f"{colour}{item.temperature_c} °C{'[/]' if colour else ''}{limit}"


def _settings(item: ServoCheckOut) -> str:
    if not item.answers:
        return _UNKNOWN
    return f"[yellow]{len(item.settings)} differ[/]" if item.settings else "as wanted"
