"""Arrays of other makers in rig files: the keys that they need, and those that they refuse."""

from importlib.resources.abc import Traversable
from pathlib import Path
from typing import get_args

import pytest

from palpate.config import load_rig, shipped_rig
from palpate.config.rig_fingers import ArrayConfig
from palpate.drivers.tactile.devices import PROTOCOLS
from palpate.drivers.tactile.messages import Shape
from palpate.drivers.tactile.mounting import Corner, Mounting
from palpate.errors import InputError
from palpate.rig.conversion import mounting_of
from palpate.rig.emulated.devices import emulate

BENCH: Traversable = shipped_rig()


def rig_text(protocol: str, *lines: str) -> str:
    """The bench, with its first array of another protocol."""
    text = BENCH.read_text(encoding="utf-8")
    return text.replace('protocol = "palpate"', "\n".join([f'protocol = "{protocol}"', *lines]), 1)


def load(folder: Path, text: str) -> Mounting | None:
    file = folder / "rig.toml"
    file.write_text(text, encoding="utf-8")
    return mounting_of(load_rig(file).fingers[0])


def test_names_are_those_that_drivers_know() -> None:
    assert get_args(ArrayConfig.model_fields["protocol"].annotation) == PROTOCOLS


def test_mountings_from_the_file(tmp_path: Path) -> None:
    assert load(tmp_path, rig_text("palpate")) is None
    assert load(tmp_path, rig_text("weiss-wts", "counts_per_n = 900.0")) == Mounting(
        Shape.CYLINDER, 5.0, 900.0
    )
    every = ["counts_per_n = 50", "matrix = 3", 'shape = "flat"', 'first_texel = "upper-right"']
    assert load(tmp_path, rig_text("weiss-dsa", *every, 'first_row = "upright"')) == Mounting(
        Shape.FLAT, 5.0, 50.0, 3, Corner.UPPER_RIGHT, upright=True
    )
    assert load(tmp_path, rig_text("weiss-dsa", "counts_per_n = 50")) == Mounting(Shape.CYLINDER, 5.0, 50.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            rig_text("weiss-dsa"),
            'fingers[0].array.counts_per_n ("f1"): is missing; arrays of protocol "weiss-dsa" do not tell it',
        ),
        (
            rig_text("weiss-wts", "counts_per_n = 0.0"),
            'fingers[0].array.counts_per_n ("f1"): is 0.0; it must be above 0',
        ),
        (
            rig_text("weiss-wts", "counts_per_n = 9.0", "matrix = 0"),
            'fingers[0].array.matrix ("f1"): is for protocol "weiss-dsa"; arrays of',
        ),
        (
            rig_text("palpate", 'first_row = "across"'),
            'fingers[0].array.first_row ("f1"): is for arrays of protocol "weiss-…"; this one',
        ),
        (
            rig_text("weiss-dsa", "counts_per_n = 9.0", 'first_texel = "left"'),
            'fingers[0].array.first_texel ("f1"): is "left"; allowed: "lower-left", "lower-right"',
        ),
        (
            rig_text("braille"),
            'fingers[0].array.protocol ("f1"): is "braille"; allowed: "palpate", "weiss-wts"',
        ),
    ],
)
def test_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, text)
    assert str(caught.value).removeprefix(f"{tmp_path}/rig.toml: ").startswith(message)


def test_flat_arrays_are_not_emulated(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(rig_text("weiss-wts", "counts_per_n = 9.0", 'shape = "flat"'), encoding="utf-8")
    with pytest.raises(InputError, match="finger f1: flat arrays cannot be emulated; leave"):
        emulate(load_rig(file), None, 1)
