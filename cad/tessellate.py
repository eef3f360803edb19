"""STEP file in, GLB file out, by OpenCASCADE: a program of its own, started by `step_files`.

What OpenCASCADE makes of a damaged file may be a crash, a search without end or more memory than there is,
and it writes to the standard output. None of this may happen to whoever reads the file.
"""

import resource
import sys

__all__ = ["main"]

_MEMORY_BYTES = 2 << 30


def main(arguments: list[str]) -> int:
    """Take the paths of both files, the deviation of chords in mm and their turn in rad; 0 if all is well."""
    # cascadio imports trimesh, where there is one, only to offer it something that is not needed here.
    sys.modules["trimesh"] = None  # type: ignore[assignment]
    import cascadio  # noqa: PLC0415 - after the line above

    source, target, off_mm, turn_rad = arguments
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
    # One thread: the same triangles in the same order, always.
    return int(
        cascadio.step_to_glb(
            source, target, tol_linear=float(off_mm), tol_angular=float(turn_rad), use_parallel=False
        )
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
