"""Meshes and drawings that try to take an import down, by the name of the file and what is wrong with it."""
# ruff: noqa: E501 - a table, in which a file is a line

import io
import zipfile
from collections.abc import Callable

__all__ = ["DRAWINGS", "MESHES", "SQUARE", "SVG", "dxf"]

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
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
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
