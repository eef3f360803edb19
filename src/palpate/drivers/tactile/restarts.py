"""Restart detection: whether an array was reset while the host talked to it.

After a reset numbers and clock begin at 0 (`docs/tactile-protocol.md`, section 1). A late copy of an old
message has a number that is behind, too, but not a clock that has run no longer than the array was not heard.
"""

from palpate.drivers.tactile.messages import Message

__all__ = ["RestartWatch"]

_SPARE_S = 0.05
_HALF_CIRCLE = 1 << 31


class RestartWatch:
    """Remembers the newest message of one array."""

    def __init__(self) -> None:
        self._last: Message | None = None
        self._heard_s = 0.0

    def note(self, message: Message, now: float) -> None:
        """A message that is in order, or begins a new order, was read at `now` (s)."""
        self._last, self._heard_s = message, now

    def behind(self, message: Message) -> str:
        """How a message that is not ahead of the newest one stands to it, for messages."""
        last = self._last or message
        return (
            f"number {message.sequence} at {message.time_us * 1e-6:.6g} s of its clock, "
            f"after number {last.sequence} at {last.time_us * 1e-6:.6g} s"
        )

    def is_restart(self, message: Message, now: float) -> bool:
        """Whether a message that was read at `now` (s) shows a reset: number and clock are behind."""
        last = self._last
        if last is None or (message.sequence - last.sequence) % (1 << 32) < _HALF_CIRCLE:
            return False
        since_us = (now - self._heard_s + _SPARE_S) * 1e6
        return message.time_us < last.time_us and message.time_us <= since_us
