"""The table of docs/safety.md, written from the fault matrix."""

from fault_rows import FAULTS
from repository import ROOT

PAGE = ROOT / "docs" / "safety.md"
_BEGIN, _END = "<!-- fault matrix: begin -->\n", "<!-- fault matrix: end -->"


def table() -> str:
    """One row a fault."""
    lines = [
        "| fault | what the stack does | what the operator sees | torque that may stay on |",
        "|---|---|---|---|",
    ]
    for fault in FAULTS:
        stays = fault.excuse or "none"
        lines.append(f"| {fault.name} | {fault.does} | {fault.sees} | {stays} |")
    return "\n".join(lines) + "\n"


def table_of_page() -> str:
    """The table as it stands on the page."""
    text = PAGE.read_text(encoding="utf-8")
    return text[text.index(_BEGIN) + len(_BEGIN) : text.index(_END)]


def write_page() -> None:
    """Write the table anew."""
    text = PAGE.read_text(encoding="utf-8")
    begin, end = text.index(_BEGIN) + len(_BEGIN), text.index(_END)
    PAGE.write_text(text[:begin] + table() + text[end:], encoding="utf-8")
