"""Tables of docs/performance.md, each between its markers: `<!-- table: NAME -->` … `<!-- end -->`."""

import platform
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

__all__ = ["PAGE", "machine", "markdown_table", "milliseconds", "update", "versions_line"]

PAGE = Path(__file__).parents[1] / "docs" / "performance.md"


def update(name: str, text: str, page: Path = PAGE) -> None:
    """Replace what is between a table's markers. Raises ValueError if the page does not have them once."""
    content, count = re.subn(
        rf"(<!-- table: {re.escape(name)} -->\n).*?(<!-- end -->)",
        lambda found: f"{found[1]}\n{text.strip()}\n\n{found[2]}",
        page.read_text(),
        flags=re.DOTALL,
    )
    if count != 1:
        raise ValueError(f"{page.name} has {count} places for the table {name!r}, not one")
    page.write_text(content)


def machine() -> str:
    """The processor's model, as the operating system names it."""
    try:
        names = re.findall(r"^model name\s*: (.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    except OSError:
        names = []
    return names[0] if names else platform.processor() or platform.machine()


def versions_line(versions: dict[str, str]) -> str:
    """What the figures below it were measured with."""
    told = ", ".join(f"{name} {number}" for name, number in sorted(versions.items(), key=_palpate_first))
    return f"{machine()}, one core; {told}."


def _palpate_first(item: tuple[str, str]) -> tuple[bool, str]:
    return item[0] != "palpate", item[0].lower()


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def milliseconds(seconds: float) -> str:
    """A time with two figures, or whole ms from 10 ms on, with its unit."""
    if seconds >= 10:
        return f"{seconds:.0f} s"
    if seconds >= 1:
        return f"{seconds:.1f} s"
    return f"{1e3 * seconds:.2g} ms" if seconds < 0.01 else f"{1e3 * seconds:.0f} ms"
