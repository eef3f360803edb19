"""The program in docs/contacts.md runs as it stands, and says what the page says."""

import re

import pytest
from repository import ROOT

from palpate.drivers.tactile.patches import ContactPatch, PatchFlag

PAGE = (ROOT / "docs" / "contacts.md").read_text(encoding="utf-8")
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def numbers(text: str) -> list[float]:
    return [float(number) for number in NUMBER.findall(text)]


def test_the_program_says_what_the_page_says(capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    exec(compile(program, "contacts.md", "exec"), {})
    said = capsys.readouterr().out
    shown = PAGE[PAGE.index(program) :].split("```text\n")[1].split("```")[0]
    assert NUMBER.sub("#", said) == NUMBER.sub("#", shown)
    assert numbers(said) == pytest.approx(numbers(shown), rel=0.15)
    # The truths that the page names are inside.
    _, direction, height, force, _ = said.splitlines()
    for line, truth in ((direction, 20.0), (height, 5.0), (force, 1.2)):
        value, bound = numbers(line)
        assert abs(value - truth) <= bound


def test_every_field_and_flag_has_its_row() -> None:
    for flag in PatchFlag:
        assert f"| `{flag.name}` |" in PAGE
    table = PAGE[PAGE.index("## Fields") : PAGE.index("## Flags")]
    for name in ContactPatch.__dataclass_fields__:
        assert f"`{name}`" in table
