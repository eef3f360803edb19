"""Arrays of other makers in rig files: the keys that they need, and those that they refuse."""

from importlib.resources.abc import Traversable
from pathlib import Path

import pytest
from firm_rig import firm_rig

from palpate.base.errors import InputError
from palpate.config import ArrayConfig, MountedArrayConfig, load_rig
from palpate.drivers.tactile.description import Corner, Mounting, Shape
from palpate.rig.conversion import mounting_of
from palpate.rig.emulated.devices import emulate

BENCH: Traversable = firm_rig()


def rig_text(protocol: str, *lines: str) -> str:
    """The bench, with its first array of another protocol."""
    text = BENCH.read_text(encoding="utf-8")
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
        emulate(load_rig(file), None, 1)
