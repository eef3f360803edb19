"""The result of `palpate doctor`: on the terminal, and as a report without private data."""

import getpass
import hashlib
import math
import platform
import re
import socket
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import tomlkit
from rich.console import Console, RenderableType
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from palpate.base.errors import quantity
from palpate.config import FingerConfig, RigFile
from palpate.config.diagnosis_results import (
    CheckOut,
    DoctorOut,
    DoctorStepOut,
    FindingOut,
    Outcome,
    Severity,
    WiringChangeOut,
    WiringOut,
)
from palpate.rig.diagnostics.wiring import Side

_PACKAGES = ("palpate", "numpy", "scipy", "pyserial", "dynamixel-sdk")
_LEFT_OUT = {"name", "obstacles", "format"}
WIRING_STEP = "wiring"
_MIN_NAME_LETTERS = 2  # letters of a name that is looked for
_REPORT_MARKS = {Outcome.WELL: "✓", Outcome.WARNING: "!", Outcome.WRONG: "✗", Outcome.SKIPPED: "–"}

_PATTERNS: tuple[tuple[str, Callable[[re.Match[str]], str]], ...] = (
    (r"/dev/serial/by-(id|path)/[^\s,;:)\"']+", lambda m: f"/dev/serial/by-{m[1]}/{_hash(m[0])}"),
    (r"(?i)socket://[^\s/:\"']+", lambda _: "socket://<host>"),
    (r"--rig (\"[^\"]*\"|'[^']*'|\S+)", lambda _: "--rig <rig file>"),
    (r"(/home|/Users)/[^\s/\"':;,]+(/[^\s\"':;,)]*)?", lambda _: "<folder>"),
    (r"[A-Za-z]:\\Users\\[^\s\"':;,]+", lambda _: "<folder>"),
    (r"\b[0-9a-fA-F]{16,}\b", lambda m: _hash(m[0])),
    (r"\b\d{1,3}(\.\d{1,3}){3}\b", lambda _: "<address>"),
)
"""What looks private whoever the user is: names of adapters have their serial number in them."""

Private = Mapping[str, str]
"""Words that must not be in a report, and what stands in their place."""


WHERE_TO_STAND = (
    "Stand so that +x of the rig file points to your right; +y points away from you then, as --picture shows."
)
"""Where somebody stands who is asked about tips: one to whom +y points has measured the frame mirrored."""

_SECTORS = ("right", "far right", "far side", "far left", "left", "near left", "near side", "near right")


def _place_words(finger: FingerConfig) -> str:
    """Words for where a finger stands in the picture of the rig file."""
    x, y = finger.base_mm
    sector = _SECTORS[round(math.atan2(y, x) / (math.pi / 4)) % len(_SECTORS)]
    return f"{finger.name} at the {sector} (base {x:.0f}, {y:.0f})"


def press_request(finger: FingerConfig, side: Side) -> str:
    """Request to press a tip on a side."""
    where = {
        Side.FRONT: "on the side that looks away from its base, near its lower end",
        Side.LEFT: "on its left, seen from its base",
        Side.RIGHT: "on its right, seen from its base",
    }[side]
    if finger.tip.kind.has_face:
        front = side is Side.FRONT
        where = f"{'low in the middle' if front else 'at the left end, seen from its base,'} of its face"
    return (
        f"The finger where the file has {_place_words(finger)}: press Enter, then hold it in one hand, and "
        f"press on its tip with a fingertip, {where}, until told to let go (n: none stands there)."
    )


def moved_question(fingers: Sequence[FingerConfig]) -> str:
    """Question which tip moved."""
    listed = "; ".join(f"{number}: {_place_words(finger)}" for number, finger in enumerate(fingers, 1))
    return f"Which tip moved? {listed}; 0: none; or x y of its base, in mm:"


def _key_words(change: WiringChangeOut) -> str:
    key = change.file_key
    return f"finger {change.finger}, {key.partition('.')[2]}" if change.finger else key


def _value_words(change: WiringChangeOut) -> str:
    if change.from_ is not None:
        return str(change.from_)
    return "(default lower-left)" if change.file_key.endswith("array.first_texel") else "(default)"


def change_lines(wiring: WiringOut) -> list[str]:
    """Changes to a rig file, a line each, and why."""
    lines = [f"{_key_words(item)}: {_value_words(item)} -> {item.to}" for item in wiring.changes]
    return [f"because {wiring.changes[0].why}:", *(f"  {line}" for line in lines)] if lines else []


def _private_words() -> Private:
    """Names of this user, computer and home folder."""
    words = {str(Path.home()): "<home>", socket.gethostname(): "<host>", platform.node(): "<host>"}
    with suppress(OSError, KeyError, ImportError):
        words[getpass.getuser()] = "<user>"
    return {word: stand_in for word, stand_in in words.items() if len(word) >= _MIN_NAME_LETTERS}


def doctor_report(out: DoctorOut | CheckOut, rig: RigFile, private: Private | None = None) -> str:
    """The report; `private`: of this computer if not given."""
    found = "".join(_step(item) for item in out.steps)
    verdict = "nothing is wrong" if out.well else f"next: {out.next}"
    text = (
        f"## palpate doctor\n\n{_versions()}\n\n"
        f"{'emulated' if out.emulated else 'real'} rig, {verdict}\n\n"
        f"```text\n{found}```\n\n### Rig file\n\n```toml\n{_rig_text(rig)}```\n"
    )
    names = {out.rig: "<rig>"} if out.rig else {}
    return _remove_private(text, {**names, **(_private_words() if private is None else private)})


def _remove_private(text: str, private: Private) -> str:
    """Without what is private, the longest words first."""
    for pattern, stand_in in _PATTERNS:
        text = re.sub(pattern, stand_in, text)
    for word in sorted(private, key=len, reverse=True):
        whole = rf"(?<![\w-]){re.escape(word)}(?![\w-])"
        text = re.sub(whole, lambda _, word=word: private[word], text, flags=re.IGNORECASE)  # type: ignore[misc]
    return text


def _versions() -> str:
    lines = [f"- {name} {found}" for name in _PACKAGES if (found := _installed_version(name)) is not None]
    lines.append(f"- Python {platform.python_version()}")
    lines.append(f"- {platform.system()} {platform.release().partition('-')[0]}, {platform.machine()}")
    return "\n".join(lines)


def _installed_version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _step(item: DoctorStepOut) -> str:
    head = f"{_REPORT_MARKS[item.outcome]} {item.step}: {item.skipped_because or item.saw}\n"
    findings = "".join(
        f"    [{found.cause}] {found.device}: {found.saw}\n"
        f"        means: {found.means}\n        next: {found.next}\n"
        for found in item.findings
    )
    return head + findings


def _rig_text(rig: RigFile) -> str:
    """The rig file without names, matrices of taxels and what stands on the table."""
    data = rig.model_dump(mode="json", exclude=_LEFT_OUT, exclude_none=True)
    for finger in data["fingers"]:
        finger["array"].pop("taxels", None)
    return tomlkit.dumps(_to_plain(data))


def _to_plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _to_plain(item) for key, item in value.items()}
    return [_to_plain(item) for item in value] if isinstance(value, list) else value


def _hash(text: str) -> str:
    return "#" + hashlib.sha256(text.encode()).hexdigest()[:8]


_TERMINAL_MARKS = {
    Outcome.WELL: "[green]✓[/]",
    Outcome.WARNING: "[yellow]![/]",
    Outcome.WRONG: "[red]✗[/]",
    Outcome.SKIPPED: "[dim]–[/]",
}
_NAME_WIDTH = 20
_INDENT = 4


def show_doctor(out: DoctorOut, console: Console, *, verbose: bool = False) -> None:
    """All steps with their findings, then how it is, and the one next thing to do.

    `verbose`: also what each step looked at.
    """
    kind = " (emulated)" if out.emulated else ""
    console.print(f"rig [bold]{escape(out.rig)}[/]{kind}\n", highlight=False)
    for item in _merge_skipped_steps(out.steps):
        _print_step(item, console, wide=verbose)
    console.print()
    console.print(_verdict(out), highlight=False)
    if out.next is not None:
        console.print(_labelled_row("next", f"[bold]{escape(out.next)}[/]"), highlight=False)


def _merge_skipped_steps(steps: tuple[DoctorStepOut, ...]) -> list[DoctorStepOut]:
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
        console.print(_columns((_TERMINAL_MARKS[item.outcome], 1), (text, None)), highlight=False)
        return
    looked = f"[dim]{escape(item.looked_at)}:[/] " if wide else ""
    cells = (
        (_TERMINAL_MARKS[item.outcome], 1),
        (escape(item.step), _NAME_WIDTH),
        (looked + escape(item.saw), None),
    )
    console.print(_columns(*cells), highlight=False)
    for found in _group_findings(item.findings):
        _print_findings(found, console)


def _group_findings(findings: tuple[FindingOut, ...]) -> list[list[FindingOut]]:
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
    _print_indented(_labelled_row("means", escape(alike[0].means)), console)
    _print_indented(_labelled_row("do", f"[bold]{escape(alike[0].next)}[/]"), console)


def _print_indented(what: RenderableType, console: Console) -> None:
    console.print(Padding(what, (0, 0, 0, _INDENT)), highlight=False)


def _labelled_row(name: str, text: str) -> Table:
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
    warnings = quantity(mild, "warning", "warnings")
    if serious:
        things = quantity(serious, "thing is", "things are")
        return f"[red bold]{things} wrong[/]" + (f", {warnings}" if mild else "")
    fine = f"[green bold]nothing is wrong[/], {warnings}" if mild else "[green bold]all well[/]"
    return fine + wiring_words(out.steps)


def wiring_words(steps: Sequence[DoctorStepOut]) -> str:
    """Words after a good verdict if nobody has looked at the wiring: exchanged arrays look well."""
    skipped = any(item.step == WIRING_STEP and item.skipped_because is not None for item in steps)
    return "; the wiring was not looked at (--press --move)" if skipped else ""
