"""Number of parts that are sought on a table."""

from dataclasses import dataclass
from typing import Self

from palpate.base.errors import InputError, printable_text
from palpate.config import RigFile

MAX_PARTS = 8
_UP_TO = "up-to-"


@dataclass(frozen=True)
class PartCount:
    """Number of parts on the table: exactly, or at most, `most`."""

    most: int = 1
    exactly: bool = True

    @classmethod
    def parse(cls, text: "str | int | PartCount") -> Self:
        """The number that a text such as "2" or "up-to-3" means; InputError for any other."""
        if isinstance(text, cls):
            return text
        words = str(text)
        number = words.removeprefix(_UP_TO)
        if not number.isdecimal() or not 1 <= int(number) <= MAX_PARTS:
            raise InputError(
                f'parts is "{printable_text(words)}"; allowed: a number from 1 to {MAX_PARTS}, or {_UP_TO}N, '
                f"such as {_UP_TO}3"
            )
        return cls(int(number), number == words)

    @property
    def is_single(self) -> bool:
        """True if one part is taken to be there, as `Search` does."""
        return self.most == 1 and self.exactly

    def __str__(self) -> str:
        return f"{'' if self.exactly else _UP_TO}{self.most}"


ONE_PART = PartCount()
"""One part, which certainly is on the table."""


def check_parts(rig: RigFile, count: PartCount, strategy: object) -> None:
    """Refuse several parts where they are not sought: by tips with flat faces, or a strategy of one's own."""
    if count.is_single:
        return
    for finger in rig.fingers:
        if finger.tip.kind.has_face:
            raise InputError(
                f'finger "{finger.name}" has a flat face, which may touch two parts at once; several parts '
                "are for round tips"
            )
    if callable(strategy):
        raise InputError("a strategy of one's own chooses grips on one part; leave it out for several parts")
