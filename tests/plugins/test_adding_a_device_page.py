"""docs/adding-a-device.md: its links lead somewhere, and its programs are those of the example."""

import re

from repository import EXAMPLES, ROOT

PAGE = ROOT / "docs" / "adding-a-device.md"
TEXT = PAGE.read_text(encoding="utf-8")


def lines_of(text: str) -> str:
    """Its lines without indentation and blank lines: a formatter may have changed them on the page."""
    return "\n".join(line.strip() for line in text.splitlines() if line.strip())


def test_programs_on_the_page_are_those_of_the_example() -> None:
    example = EXAMPLES / "array_plugin"
    files = [path.read_text(encoding="utf-8") for path in (*example.rglob("*.py"), *example.glob("*.toml"))]
    blocks = re.findall(r"```(?:python|toml)\n(.*?)```", TEXT, re.DOTALL)
    assert len(blocks) >= 4
    for block in blocks:
        assert any(lines_of(block) in lines_of(text) for text in files), block


def test_links_and_names_on_the_page_lead_somewhere() -> None:
    for name in re.findall(r"`((?:drivers|config|docs|rig|tests|examples|plugins|testing)/[\w/.-]+)`", TEXT):
        assert (ROOT / name).exists(), name
    for link in re.findall(r"\]\(([^)#]+)\)", TEXT):
        assert (PAGE.parent / link).exists(), link
