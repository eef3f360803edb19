"""Files that try to take palpate down: each with the command that reads it, made by a few lines when needed.

Shared by a benchmark, which runs them all, and by tests, which run the worst.
"""

import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from firm_rig import firm_rig
from hostile_cad_files import DRAWINGS, MESHES
from repository import EXAMPLES

from palpate.config import shipped_objects

__all__ = ["CASES", "FIRST", "Case"]

CONTACTS = EXAMPLES / "contacts.json"
OBJECTS = shipped_objects().read_text(encoding="utf-8")
RIG = firm_rig().read_text(encoding="utf-8")


@dataclass(frozen=True)
class Case:
    """A file, `name`, which `write` makes, and the command that reads it; `accepted`: it may be read, too."""

    title: str
    name: str
    command: tuple[str, ...]
    write: Callable[[Path], None]
    accepted: bool = False


READ_IN_TIME = frozenset({"a million transforms"})
"""A quick computer reads these within the limits, a slow one refuses them."""


def _text(text: str | Callable[[], str], path: Path) -> None:
    path.write_text(text if isinstance(text, str) else text(), encoding="utf-8")


def _data(data: bytes | Callable[[], bytes], path: Path) -> None:
    path.write_bytes(data if isinstance(data, bytes) else data())


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(10 << 30)


def _nothing(_: Path) -> None:
    """There is no such file."""


IMPORT = ("objects", "import", "FILE", "--units", "mm")
DRAW = (*IMPORT, "--thickness", "5")
OWN_UNITS = ("objects", "import", "FILE")
SHOW = ("objects", "show", "FILE")
READERS = {
    "rig.toml": ("check", "--rig", "FILE"),
    "references.toml": ("calibrate", "--rig", str(firm_rig()), "--references", "FILE", "--dry-run"),
    "objects.json": SHOW,
    "contacts.json": ("recognize", "--objects", str(shipped_objects()), "--contacts", "FILE"),
    "scene.json": ("identify", "--scene", "FILE"),
    "session.jsonl": ("replay", "FILE"),
    "part.stl": IMPORT,
    "part.3mf": OWN_UNITS,
    "part.step": OWN_UNITS,
    "part.dxf": DRAW,
    "part.svg": DRAW,
}
"""By the name of a file: a command that reads it."""

KINDS: dict[str, Callable[[Path], None]] = {
    "named pipe": os.mkfifo,
    "folder": lambda path: path.mkdir(),
    "endless device": lambda path: path.symlink_to("/dev/zero"),
    "link to itself": lambda path: path.symlink_to(path.name),
    "empty": partial(_data, b""),
    "10 GB, sparse": _sparse,
    "not there": _nothing,
    "random bytes": partial(_data, lambda: bytes((k * k * 31 + k // 7) % 256 for k in range(100_000))),
}


def _kinds() -> Iterator[Case]:
    for name, command in READERS.items():
        for kind, write in KINDS.items():
            yield Case(f"{name}: {kind}", name, command, write)


# TOML -----------------------------------------------------------------------------------------------------


def _rig(old: str, new: str) -> str:
    assert old in RIG
    return RIG.replace(old, new, 1)


TOMLS: dict[str, str | Callable[[], str]] = {
    "a key of 100,000 parts": lambda: ".".join(["a"] * 100_000) + " = 1\n",
    "a quoted key of 100,000 parts": lambda: ".".join(['"="'] * 100_000) + " = 1\n",
    "100,000 dotted keys": lambda: "".join(f"a.b{k}.c = 1\n" for k in range(60_000)),
    "a header of 100,000 parts": lambda: f"[{'.'.join(['a'] * 100_000)}]\n" + "x = 1\n",
    "20,000 brackets": lambda: "a = " + "[" * 20_000,
    "20,000 braces": lambda: "a = " + "{a=" * 20_000,
    "100,000 unknown keys": lambda: (
        'format = "palpate/rig@1"\n' + "".join(f"k{k}=1\n" for k in range(90_000))
    ),
    "300,000 wrong entries": lambda: 'format = "palpate/rig@1"\nfingers = [' + "0," * 300_000 + "]\n",
    "3 MB of a comment": lambda: "# " + "x" * 3_000_000,
    "a whole number of a million digits": lambda: 'format = "palpate/rig@1"\nseed = ' + "9" * 990_000,
    "the same key twice": 'format = "palpate/rig@1"\nformat = "palpate/rig@1"\n',
    "NUL": "a\0b = 1\n",
    "20,000 tables of fingers": lambda: RIG + "[[fingers]]\nname = 'f'\n" * 20_000,
    "a million tables": lambda: "[[a]]\n" * 160_000,
    "half a million escapes": lambda: 'a = "' + "\\n" * 490_000 + '"\n',
}


# JSON -----------------------------------------------------------------------------------------------------

HEAD = '{"format": "palpate/objects@1", "units": "mm", "objects": ['


def _outline(points: str, height: str = "5") -> str:
    return HEAD + f'{{"name": "a", "height": {height}, "outline": [{points}]}}]}}'


def _polygons(count: int, shape: Callable[[int], str]) -> str:
    polygons = ", ".join(f'{{"outer": [{shape(k)}]}}' for k in range(count))
    section = f'{{"z": [0, 1], "polygons": [{polygons}]}}'
    return HEAD + f'{{"name": "a", "states": [{{"name": "s", "sections": [{section}]}}]}}]}}'


def _holes(count: int) -> str:
    holes = ", ".join(f"[[{k},1],[{k}.5,1],[{k},2]]" for k in range(1, count))
    polygon = f'{{"outer": [[0,0],[{count},0],[{count},9],[0,9]], "holes": [{holes}]}}'
    section = f'{{"z": [0, 1], "polygons": [{polygon}]}}'
    return HEAD + f'{{"name": "a", "states": [{{"name": "s", "sections": [{section}]}}]}}]}}'


JSONS: dict[str, str | Callable[[], str]] = {
    "a million brackets": lambda: "[" * 1_000_000,
    "50,000 deep": lambda: '{"a":' * 50_000 + "1" + "}" * 50_000,
    "10 million empty lists": lambda: HEAD + "[]," * 10_000_000 + "0]}",
    "4 million wrong points": lambda: _outline("0," * 3_900_000 + "0"),
    "1.3 million wrong points": lambda: _outline("[]," * 1_300_000 + "0"),
    "90,000 unknown keys": lambda: HEAD + "{" + ",".join(f'"k{k}":0' for k in range(90_000)) + "}]}",
    "the same key 90,000 times": lambda: HEAD + "{" + ",".join('"k":0' for _ in range(90_000)) + "}]}",
    "a key of 10 MB": lambda: HEAD + '{"' + "k" * 10_000_000 + '": 0}]}',
    "a name of 10 MB": lambda: HEAD + '{"name": "' + "k" * 10_000_000 + '"}]}',
    "40 MB of blanks": lambda: " " * 40_000_000,
    "a whole number of a million digits": lambda: _outline("[0,0],[1,0],[1,1]", "9" * 1_000_000),
    "1e400": _outline("[0,0],[1e400,0],[1,1]"),
    "1e308": _outline("[0,0],[1e308,0],[1e308,1e308],[-1e308,1e308]"),
    "NaN": _outline("[0,0],[NaN,0],[1,1]"),
    "a lone surrogate": HEAD + r'{"name": "\ud800", "height": 1, "outline": [[0,0],[1,0],[1,1]]}]}',
    "a lone surrogate as a key": HEAD + r'{"\ud800": 1}]}',
    "NUL in a name": HEAD + r'{"name": "a\u0000b", "height": 1, "outline": [[0,0],[1,0],[1,1]]}]}',
    "300,000 crossing edges": lambda: _outline(
        ",".join(f"[{k / 1000},{k % 2 * 100}]" for k in range(300_000))
    ),
    "90,000 polygons": lambda: _polygons(90_000, lambda k: f"[{3 * k},0],[{3 * k + 2},0],[{3 * k},1]"),
    "20,000 equal polygons": lambda: _polygons(20_000, lambda _: "[0,0],[2,0],[0,1]"),
    "4,000 slivers aside": lambda: _polygons(
        4_000, lambda k: f"[{2 * k},0],[{2 * k + 9000},999],[{2 * k + 9001},999]"
    ),
    "50,000 holes": lambda: _holes(50_000),
    "200,000 objects": lambda: (
        HEAD
        + ",".join(f'{{"name":"a{k}","height":1,"outline":[[0,0],[2,0],[2,2]]}}' for k in range(200_000))
        + "]}"
    ),
    "60,000 states of a name": lambda: (
        HEAD
        + '{"name":"a","states":['
        + ",".join(
            '{"name":"s","sections":[{"z":[0,1],"polygons":[{"outer":[[0,0],[2,0],[2,2]]}]}]}'
            for _ in range(60_000)
        )
        + "]}]}"
    ),
}

CONTACT = (
    '{"finger":"f%d","touched":true,"centre":[0,0],"height":10,"tip_radius":5,"position_bound":0.3,'
    '"approach":{"direction":0,"start":[-9,0]}}'
)


def _contacts(count: int) -> str:
    text = ",".join(CONTACT % k for k in range(count))
    return f'{{"format":"palpate/contacts@1","units":"mm, rad","grips":[{{"contacts":[{text}, 0]}}]}}'


# Session logs ---------------------------------------------------------------------------------------------

FIRST = (
    '{"t_s":0.0,"event":"session","format":"palpate/session@1","palpate":"0.1.0","rig":"bench","seed":7,'
    '"strategy":"planned","scene":false,"calibration":false,"started":"2026-01-01T00:00:00+00:00",'
    '"bus_latency_s":0.001}\n'
)
LOGS: dict[str, str | Callable[[], str]] = {
    "five million short lines": lambda: FIRST + '{"t_s":0,"event":"x"}\n' * 5_000_000,
    "599,000 lines, the last wrong": lambda: (
        FIRST + '{"t_s":0,"event":"bytes","port":"a","direction":"sent","base64":"AA=="}\n' * 599_000 + "x\n"
    ),
    "600,000 long lines, the last wrong": lambda: (
        FIRST
        + ('{"t_s":0,"event":"bytes","port":"a","direction":"sent","base64":"' + "A" * 460 + '"}\n') * 599_000
        + "x\n"
    ),
    "three million small tables": lambda: (
        FIRST + ('{"t_s":0,"event":"x","a":[' + '{"a":1.5},' * 9_999 + "0]}\n") * 299 + "x\n"
    ),
    "a line of 100 MB": lambda: FIRST + '{"t_s":0,"event":"' + "x" * 100_000_000 + '"}\n',
    "lists of nothing, 30 million": lambda: (
        FIRST + ('{"t_s":0,"event":"x","a":[' + "[]," * 999 + "0]}\n") * 30_000
    ),
    "50,000 brackets": lambda: "[" * 50_000 + "\n",
    "340 MB": lambda: " " * 340_000_000,
    "a time of 5,000 digits": lambda: '{"t_s":' + "9" * 5_000 + ',"event":"session"}\n',
    "calls of 3 MB that are none": lambda: (
        FIRST + '{"t_s":0,"event":"x","calls":"' + "t1~" * 1_000_000 + '"}\n'
    ),
    "no rig beside it": FIRST,
}


def _cases() -> Iterator[Case]:
    for title, text in TOMLS.items():
        yield Case(f"rig.toml: {title}", "rig.toml", READERS["rig.toml"], partial(_text, text))
    for title, text in JSONS.items():
        yield Case(f"objects.json: {title}", "objects.json", SHOW, partial(_text, text))
    for title, count in (("100,000 fingers", 100_000), ("200,000 fingers", 200_000)):
        contacts = partial(_text, partial(_contacts, count))
        yield Case(f"contacts.json: {title}", "contacts.json", READERS["contacts.json"], contacts)
    scene = {"format": "palpate/scene@1", "object": "a", "configuration": {"x": 0, "y": 0, "theta": 0}}
    for place in ("\0", "/dev/zero", "scene.json", "../" * 5_000, "\ud800"):
        write = partial(_text, json.dumps(scene | {"objects": place}))
        yield Case(f"scene.json: objects in {place[:12]!r}", "scene.json", READERS["scene.json"], write)
    for (name, title), data in MESHES.items():
        command = IMPORT if name in {"part.stl", "part.obj", "part.ply"} else OWN_UNITS
        yield Case(f"{name}: {title}", name, command, partial(_data, data))
    for (name, title), text in DRAWINGS.items():
        command = (*OWN_UNITS, "--thickness", "5")
        yield Case(f"{name}: {title}", name, command, partial(_text, text), title in READ_IN_TIME)
    for title, text in LOGS.items():
        yield Case(f"session.jsonl: {title}", "session.jsonl", READERS["session.jsonl"], partial(_text, text))
    watched = ("watch", "--session", "FILE", "--for", "1")
    yield Case(
        "watch: 599,000 lines",
        "session.jsonl",
        watched,
        partial(_text, LOGS["599,000 lines, the last wrong"]),
    )
    yield from _kinds()


CASES = tuple(_cases())
"""All of them."""
