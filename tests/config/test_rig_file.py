"""Rig files: mistakes, the reference page, arrays."""

import copy
import json
import re
import tomllib
from collections.abc import Iterator
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import pytest
import tomlkit

from palpate.base.errors import InputError
from palpate.base.extensions import TACTILE_ARRAYS
from palpate.config import ArrayConfig, MountedArrayConfig, load_rig, shipped_rig
from palpate.config.loading import SHIPPED_RIGS
from palpate.config.rig_fingers import (
    CONTACT_LINES_PROTOCOL,
    CURRENT_PROTOCOL,
    PALPATE_PROTOCOL,
    SHIPPED_PROTOCOLS,
)
from palpate.config.rig_servos import BUILT_IN_MODELS
from palpate.config.schema import FORMATS, schema_text
from palpate.drivers.dynamixel.models import SPECIFICATIONS
from palpate.drivers.tactile.description import Corner, Mounting, Shape
from palpate.rig.conversion import mounting_of
from palpate.rig.emulated.devices import emulate
from support.benches.rigs import firm_rig
from support.commands.repository import EXAMPLES, ROOT

BENCH = firm_rig().read_text(encoding="utf-8")
ARMS = (EXAMPLES / "two-link-rig.toml").read_text(encoding="utf-8")
FRESH = (EXAMPLES / "fresh-rig.toml").read_text(encoding="utf-8")
REAL = (EXAMPLES / "real-rig.toml").read_text(encoding="utf-8")


WITHOUT_CURRENT = sorted(
    entry.name.removesuffix(".model").upper().replace("_", "-")
    for entry in (files("dynamixel_easy_sdk") / "control_table").iterdir()
    if entry.name.startswith(("x", "2x", "mx")) and "Present Current" not in entry.read_text()
)
"""Models of the vendor's tables that have no Present Current."""


def refusal(folder: Path, text: str) -> str:
    file = folder / "rig.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_rig(file)
    message = str(caught.value)
    assert "\n" not in message
    assert "http" not in message
    return message.removeprefix(f"{file}: ")


def changed(text: str, old: str, new: str, occurrence: int = 0) -> str:
    places = [match.start() for match in re.finditer(re.escape(old), text)]
    start = places[occurrence]
    return text[:start] + new + text[start + len(old) :]


def test_the_shipped_bench_is_emulated_and_has_three_fingers() -> None:
    rig = load_rig(shipped_rig())
    assert rig.emulated
    assert [finger.name for finger in rig.fingers] == ["f1", "f2", "f3"]
    assert [(f.aim.dxl_id, f.slide.dxl_id) for f in rig.fingers] == [(11, 12), (21, 22), (31, 32)]
    for finger in rig.fingers:
        assert sum(coordinate**2 for coordinate in finger.base_mm) == pytest.approx(190**2, abs=0.2)
    assert [finger.heading_deg for finger in rig.fingers] == [270.0, 30.0, 150.0]


@pytest.mark.parametrize("name", SHIPPED_RIGS)
def test_a_shipped_rig_explains_how_it_closes_and_when_it_ends(name: str) -> None:
    text = shipped_rig(name).read_text("utf-8")
    tables = re.findall(r"^\[(?:closing|search)\]\n(.*?)\n\n", text, re.M | re.S)
    values = [line for table in tables for line in table.splitlines()]
    assert len(values) > 10
    assert [line for line in values if "  # " not in line] == []


def test_search_keys_by_their_old_names_are_read_with_a_notice(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "rig.toml"
    keys = "[search]\nstranger_chance = 0.02\nunnoticed_shift_mm = 7.0\n"
    file.write_text(changed(BENCH, "[search]\n", keys), encoding="utf-8")
    search = load_rig(file).search
    assert (search.false_match_probability, search.detectable_shift_mm) == (0.02, 7.0)
    for message, names in zip(
        caplog.messages,
        (("stranger_chance", "false_match_probability"), ("unnoticed_shift_mm", "detectable_shift_mm")),
        strict=True,
    ):
        assert "\n" not in message
        assert all(name in message for name in names)


def test_a_search_key_by_both_names_is_refused(tmp_path: Path) -> None:
    keys = "[search]\nunnoticed_shift_mm = 7.0\ndetectable_shift_mm = 7.0\n"
    assert "unnoticed_shift_mm" in refusal(tmp_path, changed(BENCH, "[search]\n", keys))


def test_the_example_with_arms_is_emulated_and_has_three() -> None:
    rig = load_rig(EXAMPLES / "two-link-rig.toml")
    assert rig.emulated
    assert [finger.type for finger in rig.fingers] == ["two-link"] * 3
    ids = [[servo.dxl_id for servo in finger.servos.values()] for finger in rig.fingers]
    assert ids == [[11, 12], [21, 22], [31, 32]]


def test_the_example_of_a_fresh_rig_is_emulated_and_knows_its_stops() -> None:
    rig = load_rig(EXAMPLES / "fresh-rig.toml")
    assert rig.emulated
    assert [finger.slide.stops_mm for finger in rig.fingers] == [(43.0, 255.0)] * 3


def test_the_example_of_a_real_rig_is_accepted() -> None:
    rig = load_rig(EXAMPLES / "real-rig.toml")
    assert not rig.emulated
    assert rig.fingers[1].slide.mm_per_turn == -100.53


STAGED = changed(
    BENCH,
    "[search]",
    """[stage]
centre_mm = [0, 0]
dxl_id = 1
model = "XM430-W350"
gear_ratio = 5.0
range_deg = [-30.0, 30.0]
backlash_deg = 0.02
zero_deg = 180.0
bound_deg = 0.02

[search]""",
)


BASE = "base_mm = [-164.545, -95.0]\nheading_deg = 30.0"
BENT = changed(ARMS, "range_deg = [24.0, 142.0]", "range_deg = [-24.0, 94.0]")
TALL_ARMS = changed(ARMS, "height_mm = 10.0", "height_mm = 20.0")
SPRING = "stiffness_n_per_mm"
REACH = "range_deg = [24.0, 142.0]"
POST = '[[obstacles]]\nname = "post"\noutline_mm = '
THIN_POST = POST + "[[90, 0], [100, 0], [90, 10]]\n"

CASES = [
    (BENCH, SPRING, f"length_mm = 20.5\n{SPRING}", "fingers[0].tip.length_mm", "is 20.5, too much"),
    (BENCH, SPRING, f"length_mm = 0.0\n{SPRING}", "fingers[0].tip.length_mm", "is 0"),
    (TALL_ARMS, SPRING, f"length_mm = 24.0\n{SPRING}", "fingers[0].links.links_height_mm", "upper end (32"),
    (BENCH, "dxl_id = 22", "dxl_id = 12", "fingers[1].slide.dxl_id", '12 is the id of finger "f1" (slide)'),
    (BENCH, "dxl_id = 22", "dxl_id = 253", "fingers[1].slide.dxl_id", "must be at most 252"),
    (BENCH, "mock://f2", "mock://f1", "fingers[1].array.port", '"mock://f1" is the port of finger "f1"'),
    (BENCH, "mock://f2", "mock://bus", "fingers[1].array.port", '"mock://bus" is the port of the bus'),
    (BENCH, 'name = "f3"', 'name = "f1"', "fingers[2].name", "fingers[0] has this name"),
    (BENCH, "[-35.0, 35.0]", "[35.0, -35.0]", "fingers[0].aim.range_deg", "is [35, -35]; the first"),
    (BENCH, "[-35.0, 35.0]", "[-35.0]", "fingers[0].aim.range_deg", "has 1 value"),
    (BENCH, "45.0, 250.0", "80.0, 250.0", "fingers[0].slide.range_mm", "must wait 130 mm away"),
    (BENCH, "45.0, 250.0", "45.0, 50.0", "fingers[0]", "stays 140 mm or more from the origin"),
    (BENCH, "heading_deg = 30.0", "heading_deg = 210.0", "fingers[1]", "the tip's centre stays"),
    (BENCH, BASE, "base_mm = [-5.0, 190.0]\nheading_deg = 270.0", "fingers[1].base_mm", "is -5 mm from"),
    (BENCH, "baudrate_bps = 1000000", "baudrate_bps = 100000", "bus.baudrate_bps", "allowed: 9600, 57600"),
    (BENCH, "XM430-W350", "XM430-W999", "fingers[0].aim.model", 'allowed: "XL330-M077", "XL330-M288"'),
    (BENCH, "XM430-W350", "XM430-W355", "fingers[0].aim.model", 'did you mean "XM430-W350"?'),
    (BENCH, '"palpate"', '"contact-line"', "fingers[0].array.protocol", 'did you mean "contact-lines"?'),
    (BENCH, '"palpate"', '"sensor"', "fingers[0].array.protocol", '"contact-lines", '),
    (BENCH, "gear_ratio = 5.0", "gear_ratio = 0.0", "fingers[0].aim.gear_ratio", "is 0; it must not be"),
    (BENCH, "zero_mm = 40.0", "zero_mm = 29000.0", "fingers[0].slide.range_mm", "needs servo turns"),
    (BENCH, "zero_mm = 40.0", "zero_mm = 240.0", "fingers[0].slide.zero_mm", "at turn -1.95"),
    (FRESH, "[43.0, 255.0]", "[44.2, 255.0]", "fingers[0].slide.stops_mm", "43.98 or less and 251.6 or more"),
    (FRESH, "[43.0, 255.0]", "[43.0, 251.0]", "fingers[0].slide.stops_mm", "is [43, 251]; range_mm"),
    (FRESH, "[43.0, 255.0]", "[40.4, 255.0]", "fingers[0].slide.stops_mm", "at turn 0.004, ± 0.005"),
    (FRESH, "[43.0, 255.0]", "[43.0, 26000.0]", "fingers[0].slide.stops_mm", "servo turns 0 to 260"),
    (FRESH, "radius_bound_mm = 0.3", "radius_bound_mm = 5.0", "fingers[0].tip.radius_bound_mm", "not below"),
    (
        FRESH,
        "tip_radius_error_mm = 0.3",
        "tip_radius_error_mm = 0.4",
        "emulation.tip_radius_error_mm",
        "mm = 0.3;",
    ),
    (
        FRESH,
        "_heading_error_deg = 3.0",
        "_heading_error_deg = 4.0",
        "emulation.array_heading_error_deg",
        "deg = 3;",
    ),
    (
        FRESH,
        "mm_per_turn_error = 0.003",
        "mm_per_turn_error = 0.004",
        "emulation.mm_per_turn_error",
        "spread = 0.003",
    ),
    (BENCH, "radius_mm = 125.0", "radius = 125.0", "workspace", 'unknown key "radius"; did you mean'),
    (
        BENCH,
        "radius_mm = 125.0",
        "radius_mm = nan",
        "workspace.radius_mm",
        "is nan; it must be a finite number",
    ),
    (BENCH, "radius_mm = 125.0", "", "workspace", 'the key "radius_mm" is missing'),
    (BENCH, "[workspace]", "[worksapce]", "unknown key", '"worksapce"; did you mean "workspace"?'),
    (BENCH, "contact_force_n = 0.3", "contact_force_n = 9.0", "closing.contact_force_n", "is 9, not below"),
    (BENCH, "touch_speed_mm_s = 5.0", "touch_speed_mm_s = 90.0", "closing.touch_speed_mm_s", "is 90, above"),
    (BENCH, "max_grips = 12", "max_grips = 8.5", "search.max_grips", "must be a whole number"),
    (BENCH, "_radius_mm = 20.0", "_radius_mm = 125.0", "emulation.placement_radius_mm", "is 125"),
    (
        BENCH,
        "gain_spread = 0.2",
        "gain_spread = 0.3",
        "emulation.gain_spread",
        "bound fingers[0].array.gain_spread = 0.2;",
    ),
    (
        REAL,
        "/dev/serial/by-id/usb-palpate_array_0002-if00",
        "mock://l",
        "fingers[1].array.port",
        "no [emulation]",
    ),
    (
        BENCH,
        "$",
        POST + "[[8, 150], [20, 150], [20, 170]]\n",
        "obstacles[0].outline_mm",
        'is 3 mm from finger "f1"',
    ),
    (BENCH, "$", POST + "[[100, 0], [110, 0]]\n", "obstacles[0].outline_mm", "has 2 values; it must have at"),
    (
        BENCH,
        "$",
        POST + "[[9e1, 0], [1e2, 9], [1e2, 0], [9e1, 9]]\n",
        "obstacles[0].outline_mm",
        "at (95, 4.5): edge 0",
    ),
    (
        BENCH,
        "$",
        POST + "[[90, 0], [90, 0], [100, 0], [90, 10]]\n",
        "obstacles[0].outline_mm[1]",
        "repeats point 0",
    ),
    (BENCH, "$", 2 * THIN_POST, "obstacles[1].name", "obstacles[0] has this name already"),
    (BENCH, "$", THIN_POST.replace("_mm", ""), "obstacles[0]", '"outline"; did you mean "outline_mm"?'),
    (BENCH, "mock://bus", "/dev/ttyUSB0", "bus.port", '"/dev/ttyUSB0" is not an emulated port (mock://…)'),
    (
        BENCH,
        'name = "f2"',
        'name = "f2"\ntype = "three-link"',
        "fingers[1].type",
        'allowed: "slide", "two-link"',
    ),
    (BENCH, 'name = "f2"', 'name = "f2"\ntype = 2', "fingers[1].type", 'is 2; allowed: "slide", "two-link"'),
    (ARMS, 'type = "two-link"\n', "", "fingers[0]", 'unknown key "shoulder"; did you mean "slide"?'),
    (ARMS, "fingers.elbow", "fingers.elbwo", "fingers[0]", 'unknown key "elbwo"; did you mean "elbow"?'),
    (ARMS, "dxl_id = 12", "dxl_id = 11", "fingers[0].elbow.dxl_id", '11 is the id of finger "a1" (shoulder)'),
    (
        ARMS,
        "gear_ratio = 3.0",
        "gear_ratio = 4.0",
        "fingers[0].shoulder.range_deg",
        "servo turns -0.16 to 1.16",
    ),
    (BENT, "zero_deg = -69.0", "zero_deg = 75.0", "fingers[0].elbow.range_deg", "the elbow bends one way"),
    (ARMS, REACH, REACH.replace("142", "130"), "fingers[0].elbow.range_deg", "where it waits, at (0, 117)"),
    (
        ARMS,
        "links_height_mm = 30.0",
        "links_height_mm = 9.0",
        "fingers[0].links.links_height_mm",
        "height_mm (10)",
    ),
    (ARMS, "upper_mm = 150.0", "upper_mm = 30.0", "fingers[0].links", "cannot put the tip where it waits"),
    (ARMS, "[0.0, 230.000]", "[0.0, 100.0]", "fingers[0].base_mm", "outside of the workspace"),
    (
        ARMS,
        "joint_backlash_deg = 0.02",
        "joint_backlash_deg = 0.03",
        "emulation.joint_backlash_deg",
        "shoulder.backlash_deg",
    ),
    (ARMS, "radius_mm = 5.0", "radius_mm = 0.004", "fingers[0].tip.radius_mm", "must be at least 0.1"),
    (STAGED, "dxl_id = 1\n", "dxl_id = 11\n", "fingers[0].aim.dxl_id", "11 is the id of the stage"),
    (STAGED, "[-30.0, 30.0]", "[5.0, 30.0]", "stage.range_deg", "must contain 0, where the stage starts"),
    (STAGED, "[-30.0, 30.0]", "[-40.0, 30.0]", "stage.range_deg", "needs servo turns -0.06 to 0.92"),
    (
        STAGED,
        "offset_counts",
        "stage_error_deg = 0.1\noffset_counts",
        "emulation.stage_error_deg",
        "stage.bound_deg = 0.02",
    ),
    (BENCH, 'name = "firm-bench"', "name = bench", "not valid TOML", "line 6, column 8"),
    (BENCH, 'name = "firm-bench"', 'name = "a"\nname = "b"', "not valid TOML", "line 7, column 11"),
    (BENCH, "palpate/rig@1", "palpate/rig@2", "format", 'is "palpate/rig@2"; needed here: "palpate/rig@1"'),
]


@pytest.mark.parametrize(("source", "old", "new", "where", "word"), CASES)
def test_what_does_not_go_together_is_named(
    tmp_path: Path, source: str, old: str, new: str, where: str, word: str
) -> None:
    said = refusal(tmp_path, source + new if old == "$" else changed(source, old, new))
    named = r' \("\w+"\)' if where.startswith(("fingers[", "obstacles[")) else ""
    assert re.match(re.escape(where) + named, said)
    assert word in said[len(where) :]


def test_the_schema_that_rig_files_point_to_is_up_to_date() -> None:
    shipped = files("palpate.config").joinpath("schemas", "rig.schema.json")
    remedy = "run: palpate schema rig --out src/palpate/config/schemas/rig.schema.json"
    assert shipped.read_text(encoding="utf-8") == schema_text("rig"), remedy


@pytest.mark.parametrize("name", FORMATS)
def test_schemas_are_closed_and_without_references(name: str) -> None:
    text = schema_text(name)
    assert "$ref" not in text
    assert json.loads(text)["additionalProperties"] is False


def test_the_schema_shows_the_protocols_of_the_plug_ins_in_this_repository() -> None:
    registered: set[str] = set()
    for path in ROOT.glob("plugins/*/pyproject.toml"):
        points = tomllib.loads(path.read_text(encoding="utf-8"))["project"].get("entry-points", {})
        registered |= set(points.get(TACTILE_ARRAYS, {}))
    assert registered == set(SHIPPED_PROTOCOLS)
    array = json.loads(schema_text("rig"))["properties"]["fingers"]["items"]["oneOf"][0]["properties"][
        "array"
    ]
    assert array["properties"]["protocol"]["examples"] == [
        PALPATE_PROTOCOL,
        CURRENT_PROTOCOL,
        CONTACT_LINES_PROTOCOL,
        *SHIPPED_PROTOCOLS,
    ]


def test_every_key_of_a_rig_is_described() -> None:
    def undescribed(node: dict[str, object], path: str) -> list[str]:
        properties = node.get("properties", {})
        assert isinstance(properties, dict)
        found = []
        for key, value in properties.items():
            inner = value.get("items", value)
            tables = [option for option in inner.get("oneOf", [inner]) if "properties" in option]
            deeper = [line for table in tables for line in undescribed(table, f"{path}{key}.")]
            found += deeper if tables or "description" in value else [path + key]
        return found

    assert undescribed(json.loads(schema_text("rig")), "") == ["format", "name"]


def test_every_key_of_a_rig_is_explained_in_the_docs() -> None:
    names = ("docs/rig-file.md", "docs/emulated-rig.md", "docs/adding-a-device.md", "docs/current-sensing.md")
    pages = [*(ROOT / name for name in names), *ROOT.glob("plugins/*/README.md")]
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    documented = set(re.findall(r"`(\w+)`", text))

    def keys(node: dict[str, object]) -> set[str]:
        properties = node.get("properties", {})
        assert isinstance(properties, dict)
        leaves: set[str] = set()
        for key, value in properties.items():
            listed = value.get("items", {})
            options = [value, listed, *value.get("anyOf", []), *listed.get("oneOf", [])]
            inner = [option for option in options if "properties" in option]
            leaves |= set().union(*map(keys, inner)) if inner else {key}
        return leaves

    known = keys(json.loads(schema_text("rig")))
    assert {"dxl_id", "placement_radius_mm", "max_grips"} <= known
    assert known <= documented


def test_the_models_of_rig_files_are_those_that_drivers_know() -> None:
    assert tuple(SPECIFICATIONS) == BUILT_IN_MODELS


@pytest.mark.parametrize("model", [*WITHOUT_CURRENT, "AX-12A", "XC430-T240BB", "2XC430-W250"])
def test_a_servo_that_reports_no_current_is_refused_and_told_why(model: str, tmp_path: Path) -> None:
    said = refusal(tmp_path, changed(BENCH, "XM430-W350", model))
    assert said.startswith(f'fingers[0].aim.model ("f1"): is "{model}", which does not report its current')
    assert "docs/rig-file.md#servo-models" in said


# ----------------------------------------------------------------------------------------------------
# docs/rig-file.md: its smallest file is one, and says which keys are required.

PAGE = Path(__file__).parents[2] / "docs" / "rig-file.md"


def smallest() -> dict[str, Any]:
    text = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[0]
    return tomlkit.parse(text).unwrap()


def places(value: Any, *way: str | int) -> Iterator[tuple[str | int, ...]]:
    """Ways to every key of tables in tables and lists."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in pairs:
        if isinstance(value, dict):
            yield (*way, key)
        yield from places(item, *way, key)


def written(tmp_path: Path, rig: dict[str, Any]) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(tomlkit.dumps(rig), encoding="utf-8")
    return path


def test_the_smallest_file_is_a_rig_file(tmp_path: Path) -> None:
    assert load_rig(written(tmp_path, smallest())).fingers[0].name == "right"


@pytest.mark.parametrize("way", list(places(smallest())), ids=lambda way: ".".join(map(str, way)))
def test_every_key_of_the_smallest_file_is_required(tmp_path: Path, way: tuple[str | int, ...]) -> None:
    rig = copy.deepcopy(smallest())
    table: Any = rig
    for key in way[:-1]:
        table = table[key]
    del table[way[-1]]
    with pytest.raises(InputError, match=re.escape(str(way[-1]))):
        load_rig(written(tmp_path, rig))


# ----------------------------------------------------------------------------------------------------
# Arrays of other makers in rig files: the keys that they need, and those that they refuse.

BENCH_FILE: Traversable = firm_rig()


def rig_text(protocol: str, *lines: str) -> str:
    """The bench, with its first array of another protocol."""
    text = BENCH_FILE.read_text(encoding="utf-8")
    return text.replace('protocol = "palpate"', "\n".join([f'protocol = "{protocol}"', *lines]), 1)


def load(folder: Path, text: str) -> ArrayConfig:
    file = folder / "rig.toml"
    file.write_text(text, encoding="utf-8")
    return load_rig(file).fingers[0].array


def mounting(folder: Path, *lines: str) -> Mounting:
    array = load(folder, rig_text("weiss-dsa", *lines))
    assert isinstance(array, MountedArrayConfig)
    return mounting_of(array, 5.0)


def test_mountings_from_the_file(tmp_path: Path) -> None:
    assert type(load(tmp_path, rig_text("palpate"))) is ArrayConfig
    every = ["counts_per_n = 50", "matrix = 3", 'shape = "flat"', 'first_texel = "upper-right"']
    assert mounting(tmp_path, *every, 'first_row = "upright"') == Mounting(
        Shape.FLAT, 5.0, 50.0, Corner.UPPER_RIGHT, upright=True
    )
    assert mounting(tmp_path, "counts_per_n = 50") == Mounting(Shape.CYLINDER, 5.0, 50.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (rig_text("weiss-dsa"), ['fingers[0].array ("f1")', '"counts_per_n" is missing']),
        (rig_text("weiss-wts", "counts_per_n = 0.0"), ['array.counts_per_n ("f1")', "must be above 0"]),
        (rig_text("weiss-wts", "count_per_n = 9.0"), ['unknown key "count_per_n"', '"counts_per_n"?']),
        (rig_text("weiss-wts", "counts_per_n = 9.0", "matrix = 0"), ['unknown key "matrix"', "first_row"]),
        (rig_text("palpate", 'first_row = "across"'), ['fingers[0].array ("f1")', 'unknown key "first_row"']),
        (
            rig_text("weiss-dsa", "counts_per_n = 9.0", 'first_texel = "left"'),
            ['array.first_texel ("f1")', '"left"', '"lower-left", "lower-right"'],
        ),
        (
            rig_text("braille"),
            ['fingers[0].array.protocol ("f1")', '"braille"', '"palpate"', '"weiss-wts"', "install"],
        ),
    ],
)
def test_refused(tmp_path: Path, text: str, words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, text)
    for word in words:
        assert word in str(caught.value)


def test_flat_arrays_are_not_emulated(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(rig_text("weiss-wts", "counts_per_n = 9.0", 'shape = "flat"'), encoding="utf-8")
    with pytest.raises(InputError, match="finger f1: flat arrays cannot be emulated; leave"):
        emulate(load_rig(file), (), 1)
