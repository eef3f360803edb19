"""A doctor's result as a report for a bug tracker: Markdown with nothing private in it."""

import getpass
import hashlib
import platform
import re
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import tomlkit

from palpate.config import RigFile
from palpate.config.doctor_result import DoctorOut, DoctorStepOut, Outcome

__all__ = ["Private", "doctor_report", "private_words"]

_PACKAGES = ("palpate", "numpy", "scipy", "pyserial", "dynamixel-sdk")
_LEFT_OUT = {"name", "obstacles", "format"}
_SHORTEST = 2  # letters of a name that is looked for
_MARKS = {Outcome.WELL: "✓", Outcome.WARNING: "!", Outcome.WRONG: "✗", Outcome.SKIPPED: "–"}

_PATTERNS: tuple[tuple[str, Callable[[re.Match[str]], str]], ...] = (
    (r"/dev/serial/by-(id|path)/[^\s,;:)\"']+", lambda m: f"/dev/serial/by-{m[1]}/{_hashed(m[0])}"),
    (r"(?i)socket://[^\s/:\"']+", lambda _: "socket://<host>"),
    (r"--rig (\"[^\"]*\"|'[^']*'|\S+)", lambda _: "--rig <rig file>"),
    (r"(/home|/Users)/[^\s/\"':;,]+(/[^\s\"':;,)]*)?", lambda _: "<folder>"),
    (r"[A-Za-z]:\\Users\\[^\s\"':;,]+", lambda _: "<folder>"),
    (r"\b[0-9a-fA-F]{16,}\b", lambda m: _hashed(m[0])),
    (r"\b\d{1,3}(\.\d{1,3}){3}\b", lambda _: "<address>"),
)
"""What looks private whoever the user is: names of adapters have their serial number in them."""

Private = Mapping[str, str]
"""Words that must not be in a report, and what stands in their place."""


def private_words() -> Private:
    """Names of this user, computer and home folder."""
    words = {str(Path.home()): "<home>", socket.gethostname(): "<host>", platform.node(): "<host>"}
    with suppress(OSError, KeyError, ImportError):
        words[getpass.getuser()] = "<user>"
    return {word: stand_in for word, stand_in in words.items() if len(word) >= _SHORTEST}


def doctor_report(out: DoctorOut, rig: RigFile, private: Private | None = None) -> str:
    """The report; `private`: of this computer if not given."""
    found = "".join(_step(item) for item in out.steps)
    verdict = "nothing is wrong" if out.well else f"next: {out.next}"
    text = (
        f"## palpate doctor\n\n{_versions()}\n\n"
        f"{'emulated' if out.emulated else 'real'} rig, {verdict}\n\n"
        f"```text\n{found}```\n\n### Rig file\n\n```toml\n{_rig_text(rig)}```\n"
    )
    names = {out.rig: "<rig>"} if out.rig else {}
    return _cleaned(text, {**names, **(private_words() if private is None else private)})


def _cleaned(text: str, private: Private) -> str:
    """Without what is private, the longest words first."""
    for pattern, stand_in in _PATTERNS:
        text = re.sub(pattern, stand_in, text)
    for word in sorted(private, key=len, reverse=True):
        whole = rf"(?<![\w-]){re.escape(word)}(?![\w-])"
        text = re.sub(whole, lambda _, word=word: private[word], text, flags=re.IGNORECASE)  # type: ignore[misc]
    return text


def _versions() -> str:
    lines = [f"- {name} {found}" for name in _PACKAGES if (found := _installed(name)) is not None]
    lines.append(f"- Python {platform.python_version()}")
    lines.append(f"- {platform.system()} {platform.release().partition('-')[0]}, {platform.machine()}")
    return "\n".join(lines)


def _installed(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _step(item: DoctorStepOut) -> str:
    head = f"{_MARKS[item.outcome]} {item.step}: {item.skipped_because or item.saw}\n"
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
    return tomlkit.dumps(_plain(data))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list) else value


def _hashed(text: str) -> str:
    return "#" + hashlib.sha256(text.encode()).hexdigest()[:8]
