"""A board that resets as its port is opened, as those with an Arduino's reset circuit do. Around a device.

Opening the port raises DTR, which pulls the reset line through a capacitor. The bootloader then waits for a
new program and throws away whatever else it hears; it may print something when it gives up. Only then does
the firmware run, with all settings lost.
"""

from collections.abc import Callable

from palpate.drivers.transport.wire import Device, Emission

__all__ = ["BootingBoard"]


class BootingBoard:
    """`device` on a board that is deaf for `boot_s` after each reset, and prints `says` when that is over.

    `restart(now)` is called when the device begins to run. `boot_s` may be changed at any time.
    `reset_s`: when it resets once by itself, as by a dip of its supply; None: never. `has_dtr`: whether
    opening its port resets it.
    """

    def __init__(
        self,
        device: Device,
        boot_s: float,
        restart: Callable[[float], None],
        says: bytes = b"",
        *,
        reset_s: float | None = None,
        has_dtr: bool = True,
    ) -> None:
        self.resets = 0
        self._device = device
        self.boot_s = boot_s
        self._restart = restart
        self._says = says
        self._runs_s: float | None = None
        self._reset_s = reset_s
        self._has_dtr = has_dtr

    def opened(self, now: float) -> None:
        """Reset, if opening the port does that."""
        if self._has_dtr:
            self.reset(now)

    def reset(self, now: float) -> None:
        """Reset."""
        self._device.poll(now)  # what was on its way is lost
        self.resets += 1
        self._runs_s = now + self.boot_s

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Take bytes; the bootloader drops them."""
        said = self._boot(now)
        return said if self._runs_s is not None else said + self._device.feed(data, now)

    def poll(self, now: float) -> list[Emission]:
        """What the board sends of its own accord."""
        said = self._boot(now)
        return said if self._runs_s is not None else said + self._device.poll(now)

    def next_due(self) -> float | None:
        """When it resets or boots, or the device's next emission."""
        own = self._device.next_due() if self._runs_s is None else self._runs_s
        if self._reset_s is None:
            return own
        return self._reset_s if own is None else min(own, self._reset_s)

    def _boot(self, now: float) -> list[Emission]:
        """Reset, and begin to run, if it is time."""
        if self._reset_s is not None and now >= self._reset_s:
            at, self._reset_s = self._reset_s, None
            self.reset(at)
        if self._runs_s is None or now < self._runs_s:
            return []
        began, self._runs_s = self._runs_s, None
        self._restart(began)
        return [(began, self._says)] if self._says else []
