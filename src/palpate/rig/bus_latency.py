"""Latency of a bus's adapter: from the rig file, or from the operating system."""

from palpate.config import RigFile
from palpate.drivers.dynamixel.timing import UNKNOWN_LATENCY_S, latency_with_timer_s
from palpate.drivers.transport.adapter import EMULATED_LATENCY_S, latency_timer_s

__all__ = ["array_latency_s", "bus_latency_s", "port_latency_s"]


def bus_latency_s(rig: RigFile) -> float:
    """What the bus's adapter may add to an answer: as the rig file says, else as the system tells."""
    if rig.bus.latency_ms is not None:
        return rig.bus.latency_ms / 1e3
    if rig.emulation is None:
        return port_latency_s(rig.bus.port)
    adapter = rig.emulation.bus_adapter
    return EMULATED_LATENCY_S if adapter is None else latency_with_timer_s(adapter.latency_ms / 1e3)


def array_latency_s(rig: RigFile) -> float:
    """For how long the arrays' adapters may hold the end of a frame back: as the system tells, else 0."""
    if rig.emulation is None:
        return max(latency_timer_s(finger.array.port) or 0.0 for finger in rig.fingers)
    adapter = rig.emulation.array_adapter
    return 0.0 if adapter is None else adapter.latency_ms / 1e3


def port_latency_s(port: str) -> float:
    """The same for a port of which no rig file tells."""
    if port.startswith("mock://"):
        return EMULATED_LATENCY_S
    timer = latency_timer_s(port)
    return UNKNOWN_LATENCY_S if timer is None else latency_with_timer_s(timer)
