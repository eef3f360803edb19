"""Every row of the safety page's second table is a test, by its name; the first table is the fault matrix."""

import ast
import re

from repository import ROOT


def rows() -> list[list[str]]:
    """Cells of the table's rows."""
    page = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
    table = page[page.index("| fault | what the stack does | what the operator sees | test |") :]
    lines = table[: table.index("\n\n")].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def functions_named() -> dict[str, ast.FunctionDef]:
    """Every test function by its name."""
    found = {}
    for file in sorted((ROOT / "tests").rglob("test_*.py")):
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                found[node.name] = node
    return found


def test_every_row_names_a_test_that_exists_and_asserts_something() -> None:
    known = functions_named()
    table = rows()
    assert len(table) >= 10
    for fault, does, sees, test in table:
        assert all((fault, does, sees)), fault
        match = re.fullmatch(r"`(test_\w+)`", test)
        assert match is not None, f"{fault}: no test is named"
        assert match[1] in known, f"{fault}: there is no {match[1]}"
        body = ast.unparse(known[match[1]])
        assert "assert" in body or "pytest.raises" in body, match[1]


def test_no_test_stands_for_two_rows() -> None:
    names = [row[3] for row in rows()]
    assert len(names) == len(set(names))
