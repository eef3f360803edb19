"""`--help`: sentences are broken by the terminal, where its lines end, and not by the source's."""

from collections.abc import Iterator
from itertools import pairwise

import pytest
import typer
from typer.testing import CliRunner

from palpate.cli.main import app


def commands() -> Iterator[tuple[str, ...]]:
    root = typer.main.get_command(app)
    assert isinstance(root, typer.core.TyperGroup)
    for name, command in root.commands.items():
        yield from [(name, inner) for inner in getattr(command, "commands", ())] or [(name,)]


@pytest.mark.parametrize("words", list(commands()))
def test_a_paragraph_is_broken_only_where_a_line_is_full(words: tuple[str, ...]) -> None:
    shown = CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": "80", "TERM": "dumb"}).stdout
    text = shown.split("╭")[0].splitlines()[3:]
    assert any(line.strip() for line in text)
    for line, following in pairwise(text):
        first = following.split()[:1]
        if line.strip() and first:
            assert len(line.rstrip()) + 1 + len(first[0]) > 78, f"{line!r} has room for {first[0]!r}"
