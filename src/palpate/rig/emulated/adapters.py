"""USB adapters of an emulated rig: what the tables `bus_adapter` and `array_adapter` turn into."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from palpate.config import RigFile
from palpate.config.emulated_adapter import AdapterConfig
from palpate.drivers.emulators.usb_adapter import AdapterTruth, Grab, PluggedPort, Stalls, UsbAdapter
from palpate.drivers.transport.wire import Device

__all__ = ["behind_adapters"]

Devices = Mapping[str, tuple[Device, int]]


def behind_adapters(devices: Devices, rig: RigFile, seed: int) -> tuple[Devices, Mapping[str, str]]:
    """The devices by port behind the adapters that the rig file declares.

    Of the arrays' adapters one, drawn by the seed, is unplugged. An adapter that comes back under another
    name is among them under both: by the port's first name, the other one.
    """
    assert rig.emulation is not None
    found: dict[str, tuple[Device, int]] = {}
    renamed: dict[str, str] = {}
    chosen = 1 + int(np.random.default_rng([seed, 11]).integers(len(rig.fingers)))
    for number, (port, (device, baudrate)) in enumerate(devices.items()):
        is_bus = port == rig.bus.port
        config = rig.emulation.bus_adapter if is_bus else rig.emulation.array_adapter
        if config is None:
            found[port] = (device, baudrate)
            continue
        rng = np.random.default_rng([seed, 9, number])
        truth = adapter_truth(config, rng)
        if number not in (0, chosen):  # one array is enough
            truth = replace(truth, gone_s=None)
        adapter = UsbAdapter(device, baudrate, truth, int(rng.integers(2**32)))
        found[port] = (PluggedPort(adapter), baudrate)
        if truth.gone_s is not None and truth.renamed:
            renamed[port] = f"{port}-again"
            found[renamed[port]] = (PluggedPort(adapter, 1), baudrate)
    return found, renamed


def adapter_truth(config: AdapterConfig, rng: np.random.Generator) -> AdapterTruth:
    """What a table declares, with what the seed draws."""
    share = float(rng.uniform())
    gone = None
    if config.gone_after_s is not None:
        lo, hi = config.gone_after_s
        at = lo + share * (hi - lo)
        gone = (at, at + config.gone_for_s)
    stalls = None
    if config.stall_ms is not None:
        stalls = Stalls(config.stall_ms[0] / 1e3, config.stall_ms[1] / 1e3, config.stall_every_s)
    return AdapterTruth(
        latency_s=config.latency_ms / 1e3,
        echoes=config.echoes,
        stalls=stalls,
        gone_s=gone,
        renamed=config.comes_back_as == "other",
        grab=Grab(config.grabbed_s) if config.grabbed_s else None,
    )
