"""Devices that do almost nothing."""

from palpate.drivers.transport.wire import Device, Emission


class Quiet:
    """A device that says nothing of itself."""

    def feed(self, _data: bytes, _now: float, /) -> list[Emission]:
        return []

    def poll(self, _now: float, /) -> list[Emission]:
        return []

    def next_due(self) -> float | None:
        return None


class Passing:
    """What lies in front of a device and passes on what it says."""

    def __init__(self, device: Device) -> None:
        self._device = device

    def feed(self, data: bytes, now: float, /) -> list[Emission]:
        return self._device.feed(data, now)

    def poll(self, now: float, /) -> list[Emission]:
        return self._device.poll(now)

    def next_due(self) -> float | None:
        return self._device.next_due()
