"""Types of arrays by their numbers; a docstring or comment beside each use gives shape and unit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
"""Numbers from 0 to 255, such as pictures, masks and polarities."""
AnyArray = NDArray[np.generic]
