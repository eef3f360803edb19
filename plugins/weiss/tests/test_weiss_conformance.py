"""Both protocols of Weiss Robotics pass the suite that every array has to pass."""

from palpate.testing import ArrayConformance


class TestWts(ArrayConformance):
    protocol = "weiss-wts"
    keys = {"counts_per_n": 1000.0}


class TestDsa(ArrayConformance):
    protocol = "weiss-dsa"
    keys = {"counts_per_n": 1000.0, "matrix": 1}
