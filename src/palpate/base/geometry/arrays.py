"""Array types by element: what annotations of numpy arrays say throughout palpate."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["Bools", "Complexes", "Counts", "Floats", "Ints", "Singles"]

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Counts = NDArray[np.uint16]
