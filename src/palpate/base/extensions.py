"""Entry points: devices that installed distributions add to palpate, loaded when something names them.

A distribution registers an object under a name in one of the groups below, in its `pyproject.toml`.
`palpate.plugins` describes the required interfaces for authors. As long as only built-in devices are named,
nothing is loaded and no other distribution is examined.
"""

from collections.abc import Iterable
from importlib.metadata import entry_points

from palpate.base.errors import InputError, nearest

TACTILE_ARRAYS = "palpate.tactile_arrays"
"""Group of array protocols; the name is what `protocol` says in a rig file."""

SERVO_MODELS = "palpate.servo_models"
"""Group of servo models; the name is what `model` says in a rig file."""


def registered_names(group: str) -> list[str]:
    """Names that installed distributions have registered in `group`, in order."""
    return sorted({point.name for point in entry_points(group=group)})


def load_extension(group: str, name: str, built_in: Iterable[str]) -> object:
    """Import what is registered as `name` in `group`.

    Raises InputError if nothing is, listing what is known (`built_in` first), if two distributions register
    it, or if it cannot be imported.
    """
    found = tuple(entry_points(group=group, name=name))
    if not found:
        known = (*built_in, *registered_names(group))
        near = nearest(name, known)
        meant = "" if near is None else f'did you mean "{near}"? '
        listed = ", ".join(f'"{each}"' for each in known)
        raise InputError(
            f'is "{name}"; {meant}allowed: {listed}; for another one install the distribution that adds it '
            f'(entry point of group "{group}", docs/adding-a-device.md)'
        )
    if len(found) > 1:
        raise InputError(
            f'is "{name}", which {" and ".join(_origin(point.dist) for point in found)} add; uninstall one'
        )
    try:
        return found[0].load()
    except Exception as problem:  # whatever an author's module does while it is imported
        raise broken_plugin_error(group, name, f"{type(problem).__name__}: {problem}") from problem


def broken_plugin_error(group: str, name: str, reason: str) -> InputError:
    """The error of a plug-in that cannot be used: names its distribution and `reason`, on one line."""
    origins = [_origin(point.dist) for point in entry_points(group=group, name=name)]
    return InputError(
        f'is "{name}", a plug-in of {origins[0] if origins else "no distribution"} that cannot be used '
        f"({' '.join(reason.split())}); update or uninstall it"
    )


def _origin(distribution: object) -> str:
    name, version = getattr(distribution, "name", "?"), getattr(distribution, "version", "?")
    return f"{name} {version}"
