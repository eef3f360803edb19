"""Tactile arrays of a rig: the driver, the emulated device and the contact extractor of each finger."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar, cast

import numpy as np
from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError, InputError
from palpate.base.extensions import TACTILE_ARRAYS, broken_plugin_error, load_extension
from palpate.config import (
    ArrayConfig,
    ClosingConfig,
    ContactLinesConfig,
    ContactSourceConfig,
    FingerConfig,
    FreeRunningArrayConfig,
    RigFile,
    TipConfig,
)
from palpate.config.rig_fingers import CONTACT_LINES_PROTOCOL, PALPATE_PROTOCOL
from palpate.drivers.emulators import EmulatedArray, EmulatedContactSource, SampledArray, Taxels
from palpate.drivers.tactile import (
    MAX_LINE_BYTES,
    ArrayDriver,
    ContactExtractor,
    ContactLineDecoder,
    Description,
    FreeRunningArray,
    Port,
    Shape,
    SourceExtractor,
    TactileArray,
    TipCalibration,
    source_description,
)
from palpate.drivers.transport import Clock, PlaybackPort
from palpate.rig.conversion import first_corner, measured_force_share

ConfigT = TypeVar("ConfigT", bound=ArrayConfig)


@dataclass(frozen=True)
class ArrayPlugin(Generic[ConfigT]):
    """A kind of tactile array: what an entry point of the group `palpate.tactile_arrays` has to name.

    `config` validates the array's table of a rig file: a subclass of `ArrayConfig` with the keys that only
    this kind needs. `driver(port, clock, finger, config, tip_radius_mm)` makes the host driver on an open
    port, not yet connected; `finger` is its name, for messages. `emulated(taxels, advance, config,
    tip_radius_mm)` makes the emulated device: it calls `advance(now)` before it answers, and reads `taxels`
    when it is sampled. None: such an array cannot be emulated. `board(arrays)` makes one device of emulated
    arrays on one connection. None: each of them sends for itself.
    """

    config: type[ConfigT]
    driver: Callable[[Port, Clock, str, ConfigT, float], ArrayDriver]
    emulated: Callable[[Taxels, Callable[[float], None], ConfigT, float], SampledArray] | None = None
    board: Callable[[Sequence[Any]], SampledArray] | None = None


_SELF_DESCRIBING = ArrayPlugin(
    ArrayConfig,
    lambda port, clock, finger, config, _radius: TactileArray(port, clock, finger, first_corner(config)),
    lambda taxels, advance, config, _radius: EmulatedArray(taxels, advance, first_corner(config)),
)


def _contact_lines(
    port: Port, clock: Clock, finger: str, config: ContactLinesConfig, _tip_radius_mm: float
) -> FreeRunningArray:
    emulated = str(port.port).startswith("mock://")
    return FreeRunningArray(
        port,
        clock,
        finger,
        source_description(CONTACT_LINES_PROTOCOL, config.rate_hz, emulated=emulated),
        ContactLineDecoder(config.source, checksum=config.checksum),
        MAX_LINE_BYTES,
        config.delay_s,
    )


_BUILT_IN: Mapping[str, ArrayPlugin[Any]] = {
    PALPATE_PROTOCOL: _SELF_DESCRIBING,
    CONTACT_LINES_PROTOCOL: ArrayPlugin(
        ContactLinesConfig,
        _contact_lines,
        lambda taxels, advance, config, _radius: EmulatedContactSource(
            taxels.description, advance, config.rate_hz, config.source, config.delay_s
        ),
    ),
}


_PITCH_ROUNDING_SHARE = 1e-3  # of a pitch
_STEADY_MEAN_FRAMES = 64  # in their mean a steady push is noticed
_NOISE_FACTOR = 1.5  # times what is noticed: three standard deviations more, and it certainly is
_SEARCH_S = 10.0  # a finger's way to a part, about
_PUSH_LEVERAGE = 3.0  # a part that is pushed obliquely at its end moves under about a third of what it holds


def array_plugin(protocol: str) -> ArrayPlugin[Any]:
    """The kind of array that speaks `protocol`. Raises InputError if nothing installed does."""
    if protocol in _BUILT_IN:
        return _BUILT_IN[protocol]
    plugin = load_extension(TACTILE_ARRAYS, protocol, list(_BUILT_IN))
    if not isinstance(plugin, ArrayPlugin):
        raise broken_plugin_error(
            TACTILE_ARRAYS, protocol, f"it is a {type(plugin).__name__}, not an ArrayPlugin"
        )
    return plugin


def array_of(spec: FingerConfig, port: SerialBase | Port, clock: Clock) -> ArrayDriver:
    """The driver of a finger's array on its open port, not yet connected."""
    plugin = array_plugin(spec.array.protocol)
    return plugin.driver(cast("Port", port), clock, spec.name, spec.array, spec.tip.radius_mm)


def connect_recorded(array: ArrayDriver, port: PlaybackPort) -> None:
    """Let a driver meet what was recorded of its array, on `port`, which plays the rest.

    Raises DeviceError if it does not say what the array is.
    """
    if isinstance(array, FreeRunningArray):  # nothing was ever asked
        array.listen()
    else:
        array.connect()
    port.play()


def emulated_array(spec: FingerConfig, taxels: Taxels, advance: Callable[[float], None]) -> SampledArray:
    """The emulated device on a finger's tip. Raises InputError if its kind cannot be emulated."""
    if not spec.array.has_device:
        return EmulatedArray(taxels, advance)  # on no port, so that nobody asks it anything
    plugin = array_plugin(spec.array.protocol)
    if plugin.emulated is None:
        raise InputError(
            f'finger {spec.name}: arrays of protocol "{spec.array.protocol}" cannot be emulated; '
            "use another protocol, or a real array"
        )
    return plugin.emulated(taxels, advance, spec.array, spec.tip.radius_mm)


def extractor_of(rig: RigFile, spec: FingerConfig, description: Description) -> ContactExtractor:
    """The extractor for a finger's array.

    Raises InputError if what the rig file says of its taxels does not fit it, DeviceError if it does not show
    where a pad is touched.
    """
    if (wrong := pad_problem(spec, description)) is not None:
        raise DeviceError(f"tactile array {spec.name}: {wrong}")
    extractor = bare_extractor(rig, spec, description)
    extractor.prepare()  # at the first contact it would take longer than Bus Watchdog waits
    return extractor


def bare_extractor(rig: RigFile, spec: FingerConfig, description: Description) -> ContactExtractor:
    """The same, not prepared, of an array that need not fit a pad. Raises InputError as `extractor_of`."""
    if isinstance(spec.array, ContactSourceConfig):
        return SourceExtractor(
            description, math.radians(spec.array.angle_bound_deg), spec.array.force_bound_n
        )
    return ContactExtractor(description, calibration_of(rig, spec, description))


def pad_problem(spec: FingerConfig, description: Description) -> str | None:
    """Why an array does not show where along a pad's face it is touched; None if it does, or is on no pad."""
    if not spec.tip.kind.has_face:
        return None
    if description.shape is not Shape.FLAT or description.cols < 2:
        return "its tip is a pad, and the array is not flat, of two columns or more"
    pitches, pitch = np.diff(description.columns), spec.array.pitch_mm or 0.0
    room = _PITCH_ROUNDING_SHARE * pitch
    if pitches.max() > pitch + room:
        return f"its columns are {pitches.max():.3g} mm apart, more than array.pitch_mm ({pitch:g})"
    ends = description.columns[0] - pitches[0] / 2, description.columns[-1] + pitches[-1] / 2
    half = spec.tip.radius_mm + spec.tip.radius_bound_mm
    if not (-pitches[0] <= ends[0] + half <= room and -room <= ends[1] - half <= pitches[-1]):
        return (
            f"its {description.cols} columns, {pitches.max():.3g} mm apart, reach from {ends[0]:.4g} to "
            f"{ends[1]:.4g} mm across, and the pad's face, {spec.tip.width_mm:g} mm wide, from {-half:g} to "
            f"{half:g} at most (tip.width_mm, radius_bound_mm): they must cover the face, and no more"
        )
    return _height_problem(description, spec.tip.length_mm)


def _height_problem(description: Description, length_mm: float | None) -> str | None:
    """The same, of the rows of an array on a pad's face whose height is stated."""
    rows = np.diff(description.row_heights_mm)
    if length_mm is None or not rows.size:
        return None
    high = description.row_heights_mm[-1] - description.row_heights_mm[0] + (rows[0] + rows[-1]) / 2
    if high >= length_mm * (1 - _PITCH_ROUNDING_SHARE):
        return None
    return (
        f"its {description.rows} rows, {rows.max():.3g} mm apart, are {high:.4g} mm high, and the pad's face "
        f"{length_mm:g} mm (tip.length_mm): they must cover the face"
    )


def shape_warning(spec: FingerConfig, description: Description) -> str | None:
    """Warning about a flat array on a tip that is no pad; None if there is none."""
    if spec.tip.kind.has_face or description.shape is not Shape.FLAT:
        return None
    return (
        f"it is flat, and its tip is declared a {spec.tip.shape}: if the flat face is what touches, declare "
        'tip.shape = "pad", tip.width_mm and array.pitch_mm, or answers will be wrong'
    )


def threshold_problem(
    extractor: ContactExtractor, closing: ClosingConfig, tip: TipConfig | None = None
) -> str | None:
    """Problem with contact_force_n for an array that is tared: untouched, it would exceed it.

    Or, on a pad, it may not be felt at all where it is spread over the whole face, at the end of a way.
    """
    if isinstance(extractor, SourceExtractor):
        return extractor.threshold_problem(closing.contact_force_n)
    least = extractor.least_force_n
    hidden_n = extractor.spread_hidden_n(_SEARCH_S)
    if tip is not None and tip.kind.has_face and closing.contact_force_n < hidden_n:
        return (
            f"its noise and drift may hide {hidden_n:.2g} N that press evenly on all of the "
            f"pad, more than contact_force_n = {closing.contact_force_n:g} N; raise that"
        )
    if closing.contact_force_n >= least:
        return None
    return (
        f"its noise of {extractor.baseline.noise_counts:.2g} counts would pass for a contact of "
        f"contact_force_n = {closing.contact_force_n:g} N; use {least:.2g} N at least"
    )


def doubt_warning(rig: RigFile, spec: FingerConfig, extractor: ContactExtractor) -> str | None:
    """Why grips will not be believed, with an array that is tared: None, or what it may hide is too much."""
    holds = rig.search.part_holds_n
    if holds is None:
        return None
    noise = _NOISE_FACTOR * extractor.least_force_n * extractor.noise_share(_STEADY_MEAN_FRAMES)
    doubt = extractor.zero_doubt_n[0] + extractor.zero_doubt_n_per_s * _SEARCH_S
    hidden = (noise + doubt) / (1 - measured_force_share(spec))
    if hidden * len(rig.fingers) * _PUSH_LEVERAGE <= holds:
        return None
    return (
        f"noise and drift of its zeros may hide a push of {hidden:.2g} N; if every finger's do, a part that "
        f"holds part_holds_n = {holds:g} N may move unnoticed, and grips will not be believed: "
        "calibrate it with nothing near the tips, or measure what the part holds with palpate check --hold"
    )


def _apparent_stiffness(tip: TipConfig) -> tuple[float, float]:
    """Stiffness (N/mm) for which patterns are looked for, and the share by which it may be off.

    Beside its equator a ball shows the wider patterns of a softer cylinder: the circle that touches is
    smaller by some share, and dented more by the same share.
    """
    if tip.least_share == 1.0:
        return tip.stiffness_n_per_mm, tip.stiffness_spread
    low = (1 - tip.stiffness_spread) * tip.least_share**2
    high = 1 + tip.stiffness_spread
    return tip.stiffness_n_per_mm * (high + low) / 2, (high - low) / (high + low)


def calibration_of(rig: RigFile, spec: FingerConfig, description: Description) -> TipCalibration:
    """Calibration of a finger's array: of every taxel where it was calibrated, else of all alike.

    Raises InputError if the calibrated taxels are not as many as the array's.
    """
    shape = (description.rows, description.cols)
    stiffness, spread = _apparent_stiffness(spec.tip)
    alike = TipCalibration(
        gain=np.ones(shape),
        gain_spread=spec.array.gain_spread,
        noise_counts=spec.array.idle_noise_counts,
        contact_force_n=rig.closing.contact_force_n / 2,
        stiffness_n_per_mm=stiffness,
        stiffness_bound=spread,
        drift_counts_per_s=spec.array.drift_counts_per_s,
        is_common=isinstance(spec.array, FreeRunningArrayConfig),
    )
    taxels = spec.array.taxels
    if taxels is None:
        return alike
    gain = np.array(taxels.gain)
    if gain.shape != shape:
        remedy = "" if rig.why_not("calibrate") else "calibrate this finger again, or "
        raise InputError(
            f"finger {spec.name}: array.taxels are {gain.shape[0]} x {gain.shape[1]} and the array has "
            f"{shape[0]} x {shape[1]}; {remedy}leave array.taxels out"
        )
    usable = np.ones(shape, dtype=bool)
    for row, col in taxels.unusable:
        usable[row, col] = False
    return replace(
        alike,
        gain=gain,
        gain_spread=np.array(taxels.gain_bound),
        noise_counts=taxels.noise_counts,
        crosstalk=taxels.crosstalk,
        crosstalk_bound=taxels.crosstalk_bound,
        force_drift_n_per_s=taxels.force_drift_n_per_s,
        usable=usable,
    )
