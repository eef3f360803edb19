"""What a message has to say, however it is worded."""

__all__ = ["missing"]


def missing(message: str, *words: object) -> list[str]:
    """Those of some words, names and values that a message does not hold."""
    return [str(word) for word in words if str(word) not in message]
