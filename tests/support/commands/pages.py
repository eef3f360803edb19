"""Pages and the commands in them."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

from support.commands.repository import ROOT

# ----------------------------------------------------------------------------------------------------
# A report's page as a reader has it: headings and words; well-formed, and in need of nothing else.

_VOID = {"meta", "link", "br", "img"}


class Page(HTMLParser):
    """Headings, words and tables of a page; fails where tags do not close in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.headings: list[str] = []
        self.words: list[str] = []
        self.addresses: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag not in ("script", "iframe", "object", "embed", "link", "base", "form")
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]
        assert not any(name.startswith("on") for name, _ in attrs)
        if tag not in _VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in _VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("h1", "h2"):
            self.headings.append(data)
        self.words.append(data)


# ----------------------------------------------------------------------------------------------------
# Commands in the documentation: what stands behind a prompt, with the output that stands beneath it.

PAGES = [ROOT / "README.md", *sorted(ROOT.glob("docs/*.md"))]
_PROMPT = re.compile(r"^(\s*)\$ (?:\.venv/bin/)?palpate (.*)$")
_MENTION = re.compile(r"(?:^\s*\$ |^    |`)(?:\.venv/bin/)?palpate ((?:[a-z-]+)[^`|]*)")
_VOLATILE = (  # what depends on the computer and the day
    (r"\d+(\.\d+)? (ms|kB|MB)\b", r"# \2"),
    (r"\d+(\.\d+)? s( here)?$", r"# s\2"),
    (r"/dev/pts/\d+", "/dev/pts/#"),
    (r"20\d\d-\d\d-\d\d \d\d:\d\d", "#"),
    (r"(-seed-\d+)-[0-9a-f]{8}\b", r"\1-#"),
    (r"[ ]+", " "),
)


@dataclass(frozen=True)
class Shown:
    """A command behind a prompt, and the lines beneath it."""

    page: Path
    line: int
    words: tuple[str, ...]
    output: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.page.name}:{self.line} palpate {shlex.join(self.words)}"


def shown_on(page: Path) -> Iterator[Shown]:
    """The commands of a page that stand behind a prompt, in order."""
    lines = page.read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines):
        found = _PROMPT.match(line)
        if found is not None:
            output = _beneath(lines[number + 1 :], found[1])
            yield Shown(page, number + 1, tuple(shlex.split(found[2])), tuple(output))


def _beneath(lines: list[str], indent: str) -> Iterator[str]:
    """To the end of the block, or the next prompt."""
    for line in lines:
        fence_ends = not indent and line.startswith("```")
        block_ends = bool(indent) and bool(line.strip()) and not line.startswith(indent)
        if fence_ends or block_ends or _PROMPT.match(line):
            return
        yield line.removeprefix(indent)


def mentioned(page: Path) -> Iterator[tuple[int, list[str]]]:
    """Line number and words of every command of palpate on a page, behind a prompt or not."""
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        for found in _MENTION.finditer(line):
            yield number, re.findall(r"[^\s\[\],;()]+", found[1].split(" # ")[0])


def differences(shown: Shown, output: str) -> list[str]:
    """Lines of the page that the output does not have there; a line … stands for any others.

    Where nothing stands beneath a command, its output is left out.
    """
    if not any(line.strip() for line in shown.output):
        return []
    expected = [_plain(line) for line in shown.output]
    while expected and not expected[-1]:
        expected.pop()
    found = [_plain(line) for line in output.rstrip("\n").split("\n")]
    return _compared(expected, found)


def _compared(expected: list[str], found: list[str]) -> list[str]:
    for k, line in enumerate(expected):
        if line == "…":
            rest = expected[k + 1 :]
            ends = range(k, len(found) + 1)
            return [] if any(not _compared(rest, found[end:]) for end in ends) else ["nothing after … agrees"]
        if k >= len(found) or line != found[k]:
            return [f"- {line}", f"+ {found[k] if k < len(found) else '(nothing)'}"]
    return [f"+ {line}" for line in found[len(expected) : len(expected) + 1]]


def _plain(line: str) -> str:
    for pattern, text in _VOLATILE:
        line = re.sub(pattern, text, line)
    return line.strip()
