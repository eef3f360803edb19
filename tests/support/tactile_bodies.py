"""Hypothesis strategies of everything that an array and its host may say to each other."""

import math

import numpy as np
from hypothesis import strategies as st

from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.messages import (
    Ack,
    BadTaxel,
    Describe,
    Frame,
    Geometry,
    Hello,
    MessageBody,
    Nack,
    NackReason,
    Rate,
    SelfTest,
    SelfTestReport,
    SelfTestResult,
    Start,
    Stop,
    Tare,
    TaxelFault,
    TaxelPlaces,
)

u8, u16, u32, u64 = (st.integers(0, 2**n - 1) for n in (8, 16, 32, 64))
real = st.floats(-1000, 1000, width=32)
positive = st.floats(2**-9, 2**16, width=32)


@st.composite
def descriptions(draw: st.DrawFn) -> Description:
    """Any array, as DESCRIBE tells of it."""
    rows, cols = draw(st.integers(1, 6)), draw(st.integers(1, 30))
    shape = draw(st.sampled_from(Shape))
    grid = shape is not Shape.FREE
    return Description(
        unique_id=draw(st.binary(min_size=16, max_size=16)),
        firmware=draw(st.text(max_size=60)),
        emulated=draw(st.booleans()),
        shape=shape,
        rows=rows,
        cols=cols,
        bit_depth=draw(st.integers(1, 16)),
        max_rate_hz=draw(st.integers(1, 10**6)) / 1000,
        full_scale_n=draw(positive),
        counts_per_n=draw(positive),
        tip_radius_mm=draw(st.floats(0.125, 1000, width=32)),
        columns=_ascending(draw, cols, 3.0 if shape is Shape.CYLINDER else 900.0) if grid else (),
        row_heights_mm=_ascending(draw, rows, 900.0) if grid else (),
    )


def _ascending(draw: st.DrawFn, count: int, farthest: float) -> tuple[float, ...]:
    """Places within ± `farthest` that are a thousandth of it apart or more, as 32-bit floats have them."""
    steps = draw(st.lists(st.integers(-1000, 1000), min_size=count, max_size=count, unique=True))
    return tuple(float(np.float32(step / 1000 * farthest)) for step in sorted(steps))


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    """Any frame of up to 9 x 21 taxels."""
    rows, cols = draw(st.integers(1, 9)), draw(st.integers(1, 21))
    return Frame(rows, cols, draw(st.binary(min_size=2 * rows * cols, max_size=2 * rows * cols)))


@st.composite
def places(draw: st.DrawFn) -> tuple[float, ...]:
    """Places of one to five taxels, with normals of length 1 as 32-bit floats have it."""
    out: list[float] = []
    for _ in range(draw(st.integers(1, 5))):
        azimuth, height = draw(st.floats(-math.pi, math.pi)), draw(st.floats(-1, 1))
        level = math.sqrt(1 - height**2)
        normal = (level * math.cos(azimuth), level * math.sin(azimuth), height)
        out += [draw(real) for _ in range(3)] + [float(np.float32(part)) for part in normal]
    return tuple(out)


@st.composite
def reports(draw: st.DrawFn) -> SelfTestReport:
    """Any report; its list is short, or as long as it can be."""
    count = draw(st.one_of(st.integers(0, 4), st.sampled_from([254, 255, 256, 4096])))
    one = draw(st.builds(BadTaxel, u8, u8, st.sampled_from(TaxelFault)))
    return SelfTestReport(draw(u16), SelfTestResult(draw(u16)), count, (one,) * min(count, 255))


bodies: st.SearchStrategy[MessageBody] = st.one_of(
    st.builds(Hello, u16),
    st.builds(Start, u16, u32),
    st.builds(Stop, u16),
    st.builds(Rate, u16, u32),
    st.builds(Tare, u16, u16, u16),
    st.builds(SelfTest, u16),
    st.builds(Geometry, u16, u16),
    st.builds(Ack, u16),
    st.builds(Nack, u16, st.sampled_from(NackReason)),
    st.builds(Describe, u16, descriptions()),
    reports(),
    st.builds(TaxelPlaces, u16, u16, places()),
    frames(),
)
