"""The built-in protocol passes the suite that plug-ins have to pass; unknown protocols are named."""

import pytest

from palpate.base.errors import InputError
from palpate.rig.arrays import array_plugin
from palpate.testing import ArrayConformance


class TestPalpateArray(ArrayConformance):
    protocol = "palpate"


def test_an_unknown_protocol_lists_known_ones_and_says_how_to_add_one() -> None:
    with pytest.raises(InputError) as caught:
        array_plugin("braille")
    for words in (
        '"braille"',
        '"palpate"',
        '"weiss-dsa"',
        '"weiss-wts"',
        "install",
        "palpate.tactile_arrays",
    ):
        assert words in str(caught.value)
