"""Files that mean harm."""

import io
import json
import os
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from palpate.config import shipped_objects
from support.benches.rigs import firm_rig
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# Meshes and drawings that try to take an import down, by the name of the file and what is wrong with it.

# ruff: noqa: E501 - a table, in which a file is a line


# Meshes ---------------------------------------------------------------------------------------------------

PLY = (
    "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {}\nproperty list uchar int vertex_indices\nend_header\n"
)
MODEL = (
    '<model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>{}'
    "</resources><build>{}</build></model>"
)


def _zip(model: str, *others: tuple[str, int]) -> bytes:
    """A 3MF file with further members of so many zeros."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("3D/3dmodel.model", model)
        for name, size in others:
            with archive.open(name, "w", force_zip64=True) as member:
                for _ in range(size // 1_000_000):
                    member.write(bytes(1_000_000))
    return whole.getvalue()


def _lying_zip() -> bytes:
    """A member of 300 MB, of which the directory says that it has a hundred bytes."""
    data = bytearray(_zip(MODEL.format("", ""), ("3D/other.model", 300_000_000)))
    size = (300_000_000).to_bytes(4, "little")
    while (at := data.find(size)) >= 0:
        data[at : at + 4] = (100).to_bytes(4, "little")
    return bytes(data)


def _tree_of_components(levels: int, copies: int) -> str:
    objects = (
        '<object id="0"><mesh><vertices><vertex x="0" y="0" z="0"/></vertices><triangles/></mesh></object>'
    )
    for level in range(1, levels):
        inner = f'<component objectid="{level - 1}"/>' * copies
        objects += f'<object id="{level}"><components>{inner}</components></object>'
    return MODEL.format(objects, f'<item objectid="{levels - 1}"/>')


def _laughs(levels: int) -> str:
    entities = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, levels))
    return f'<!DOCTYPE x [<!ENTITY e0 "lol">{entities}]>'


MESHES: dict[tuple[str, str], bytes | Callable[[], bytes]] = {
    ("part.stl", "announces 4 thousand million faces"): b"\0" * 80 + b"\xff" * 4 + b"\0" * 50,
    ("part.stl", "a million solids"): lambda: b"solid\n" * 1_000_000,
    ("part.stl", "numbers that are none"): (
        b"solid a\nfacet normal 0 0 1\nouter loop\n"
        + b"vertex nan inf 1e999\n" * 3
        + b"endloop\nendfacet\nendsolid a\n"
    ),
    ("part.stl", "one face, 60 MB of blanks"): lambda: b"solid a\n" + b" \n" * 30_000_000 + b"endsolid a\n",
    ("part.stl", "a million faces"): lambda: (
        b"\0" * 80 + (1_000_000).to_bytes(4, "little") + bytes(50_000_000)
    ),
    ("part.stl", "70 MB"): lambda: b"\0" * 70_000_000,
    ("part.obj", "a face of a million corners"): lambda: b"v 0 0 0\n" * 9 + b"f" + b" 1" * 1_000_000,
    ("part.obj", "a vertex far beyond"): b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n",
    ("part.obj", "5 million vertices"): lambda: b"v 1 2 3\n" * 5_000_000 + b"f 1 2 3\n",
    ("part.obj", "a million groups"): lambda: b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"g a\nf 1 2 3\n" * 1_000_000,
    ("part.ply", "announces vertices that it lacks"): (PLY.format("ascii", 1000, 4) + "0 0 0\n").encode(),
    ("part.ply", "announces 10^11 vertices"): PLY.format("binary_little_endian", 10**11, 1).encode(),
    ("part.ply", "announces 10^30 faces"): PLY.format("ascii", 1, 10**30).encode() + b"0 0 0\n",
    ("part.ply", "lists longer than the file"): (
        PLY.format("binary_little_endian", 1, 4).encode() + b"\0" * 12 + b"\xff" * 40
    ),
    ("part.ply", "no end of its header"): b"ply\nformat ascii 1.0\n" + b"comment x\n" * 1_000_000,
    ("part.3mf", "ZIP bomb, 4 GB"): lambda: _zip(MODEL.format("", ""), ("3D/other.model", 2_900_000_000)),
    ("part.3mf", "an unused member of 1 GB"): lambda: _zip(MODEL.format("", ""), ("x.png", 1_000_000_000)),
    ("part.3mf", "a directory that lies"): _lying_zip,
    ("part.3mf", "5,000 members"): lambda: _zip(MODEL.format("", ""), *((f"m{k}", 0) for k in range(5_000))),
    ("part.3mf", "copies of copies"): lambda: _zip(_tree_of_components(20, 10)),
    ("part.3mf", "a component of itself"): lambda: _zip(
        MODEL.format(
            '<object id="1"><components><component objectid="1"/></components></object>',
            '<item objectid="1"/>',
        )
    ),
    ("part.3mf", "entities of entities"): lambda: _zip(
        _laughs(10) + MODEL.format("<metadata name='a'>&e9;</metadata>", "")
    ),
    ("part.3mf", "an entity from outside"): lambda: _zip(
        '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>'
        + MODEL.format('<object id="1" name="a">&e;</object>', '<item objectid="1"/>')
    ),
    ("part.3mf", "60 MB of vertices"): lambda: _zip(
        MODEL.format(
            '<object id="1"><mesh><vertices>'
            + '<vertex x="0" y="0" z="0"/>' * 2_200_000
            + "</vertices><triangles/></mesh></object>",
            '<item objectid="1"/>',
        )
    ),
    ("part.3mf", "a million elements, nested"): lambda: _zip("<a>" * 1_000_000),
    ("part.step", "nothing within"): b"ISO-10303-21;\nEND-ISO-10303-21;\n",
    ("part.step", "a unit of itself"): (
        b"ISO-10303-21;\nDATA;\n#1=(CONVERSION_BASED_UNIT('a',#2)LENGTH_UNIT());\n"
        b"#2=LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.),#1);\n"
        b"#3=(GLOBAL_UNIT_ASSIGNED_CONTEXT((#1)));\nENDSEC;\nEND-ISO-10303-21;\n"
    ),
    ("part.step", "two million entities"): lambda: (
        b"ISO-10303-21;\nDATA;\n#3=(GLOBAL_UNIT_ASSIGNED_CONTEXT((#4)));\n"
        b"#4=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));\n"
        + b"#9=CARTESIAN_POINT('',(0.,0.,0.));\n" * 1_600_000
        + b"ENDSEC;\nEND-ISO-10303-21;\n"
    ),
    ("part.step", "quotes that do not end"): lambda: (
        b"ISO-10303-21;\n" + b"#1='" * 2_000_000 + b"\nEND-ISO-10303-21;"
    ),
}


# Drawings -------------------------------------------------------------------------------------------------

SVG = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" width="99mm" height="99mm" viewBox="0 0 99 99">{}</svg>'
SQUARE = "0\nLINE\n8\n0\n10\n0\n20\n0\n11\n9\n21\n9\n"


def _uses(levels: int) -> str:
    text = '<rect id="u0" width="9" height="9"/>'
    for level in range(1, levels):
        text += f'<g id="u{level}">' + f'<use xlink:href="#u{level - 1}"/>' * 10 + "</g>"
    return SVG.format(text)


def dxf(entities: str, blocks: str = "") -> str:
    units = "0\nSECTION\n2\nHEADER\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n"
    return f"{units}0\nSECTION\n2\nBLOCKS\n{blocks}0\nENDSEC\n0\nSECTION\n2\nENTITIES\n{entities}0\nENDSEC\n0\nEOF\n"


def _block(name: str, entities: str) -> str:
    return f"0\nBLOCK\n8\n0\n2\n{name}\n70\n0\n10\n0\n20\n0\n30\n0\n3\n{name}\n{entities}0\nENDBLK\n8\n0\n"


def _insert(name: str, rest: str = "") -> str:
    return f"0\nINSERT\n8\n0\n2\n{name}\n10\n0\n20\n0\n{rest}"


def _inserts(levels: int, copies: int) -> str:
    blocks = _block("B0", SQUARE)
    for level in range(1, levels):
        blocks += _block(f"B{level}", _insert(f"B{level - 1}") * copies)
    return dxf(_insert(f"B{levels - 1}"), blocks)


def _circle_of(count: int) -> str:
    return " ".join(f"{k % 1000},{k // 1000}" for k in range(count))


DRAWINGS: dict[tuple[str, str], str | Callable[[], str]] = {
    ("part.svg", "copies of copies"): lambda: _uses(12),
    ("part.svg", "a copy of itself"): SVG.format('<g id="a"><use xlink:href="#a"/></g>'),
    ("part.svg", "20,000 groups, nested"): lambda: SVG.format("<g>" * 20_000 + "</g>" * 20_000),
    ("part.svg", "a million vertices"): lambda: SVG.format(f'<polygon points="{_circle_of(1_000_000)}"/>'),
    ("part.svg", "150,000 vertices"): lambda: SVG.format(f'<polygon points="{_circle_of(150_000)}"/>'),
    ("part.svg", "a million elements"): lambda: SVG.format('<rect width="9" height="9"/>' * 1_000_000),
    ("part.svg", "40,000 equal squares"): lambda: SVG.format('<rect width="9" height="9"/>' * 40_000),
    ("part.svg", "entities of entities"): lambda: _laughs(10) + SVG.format("<text>&e9;</text>"),
    ("part.svg", "an entity from outside"): '<!DOCTYPE svg [<!ENTITY e SYSTEM "file:///etc/passwd">]>'
    + SVG.format('<path id="&e;" d="M0 0"/>'),
    ("part.svg", "1e308"): SVG.format('<path d="M0 0 L1e308 0 L1e308 1e308 Z"/>'),
    ("part.svg", "1e999"): SVG.format('<path d="M0 0 L1e999 0 L0 1e999 Z"/>'),
    ("part.svg", "an arc of 1e12"): SVG.format('<path d="M0 0 A1e12 1e12 0 1 1 50 50 Z"/>'),
    ("part.svg", "a million transforms"): lambda: SVG.format(
        f'<rect width="9" height="9" transform="{"scale(1)" * 1_000_000}"/>'
    ),
    ("part.svg", "a style of 10 MB"): lambda: SVG.format(
        f"<style>{'a{b:c}' * 1_600_000}</style><rect width='9'/>"
    ),
    ("part.svg", "UTF-7"): '<?xml version="1.0" encoding="utf-7"?><svg/>',
    ("part.svg", "an STL file"): "solid a\nendsolid a\n",
    ("part.dxf", "blocks of blocks"): lambda: _inserts(20, 10),
    ("part.dxf", "blocks 500 deep"): lambda: _inserts(500, 1),
    ("part.dxf", "a block of itself"): dxf(_insert("A"), _block("A", _insert("A"))),
    ("part.dxf", "a block, 30,000 by 30,000 times"): dxf(
        _insert("A", "70\n30000\n71\n30000\n44\n1\n45\n1\n"), _block("A", SQUARE)
    ),
    ("part.dxf", "no block, 30,000 by 30,000 times"): dxf(
        _insert("A", "70\n30000\n71\n30000\n44\n1\n45\n1\n"), _block("A", "")
    ),
    ("part.dxf", "300,000 lines"): lambda: dxf(SQUARE * 300_000),
    ("part.dxf", "40,000 lines to one point"): lambda: dxf(
        "".join(f"0\nLINE\n8\n0\n10\n0\n20\n0\n11\n{k % 200}\n21\n{k / 200}\n" for k in range(40_000))
    ),
    ("part.dxf", "a circle of 1e300"): dxf("0\nCIRCLE\n8\n0\n10\n0\n20\n0\n40\n1e300\n"),
    ("part.dxf", "a spline of degree 1000"): lambda: dxf(
        "0\nSPLINE\n8\n0\n70\n8\n71\n1000\n72\n2002\n73\n1001\n"
        + "40\n0\n" * 1001
        + "40\n1\n" * 1001
        + "10\n0\n20\n0\n30\n0\n" * 1001
    ),
    ("part.dxf", "an announced million of vertices"): dxf(
        "0\nLWPOLYLINE\n8\n0\n90\n1000000\n70\n1\n10\n0\n20\n0\n"
    ),
    ("part.dxf", "tags without end"): lambda: "0\nSECTION\n2\nENTITIES\n" + "0\nLINE\n" * 2_000_000,
    ("part.dxf", "numbers that are none"): dxf("0\nLINE\n8\n0\n10\nnan\n20\ninf\n11\n1e999\n21\nx\n"),
}


# ----------------------------------------------------------------------------------------------------
# Files that try to take palpate down: each with the command that reads it, made by a few lines when needed.
#
# Shared by a benchmark, which runs them all, and by tests, which run the worst.

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
