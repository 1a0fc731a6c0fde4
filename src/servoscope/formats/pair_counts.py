"""How many poses lie near each of others: the one loop over pairs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled


@compiled()
def count_pairs(
    a: NDArray[np.float64], b: NDArray[np.float64], far_squared: float, least_trace: float
) -> NDArray[np.intp]:
    """How many of `b` lie within the limits of each of `a`, both 3 x 4 matrices as rows."""
    counts = np.zeros(len(a), dtype=np.intp)
    for i in range(len(a)):
        for j in range(len(b)):
            x, y, z = a[i, 3] - b[j, 3], a[i, 7] - b[j, 7], a[i, 11] - b[j, 11]
            if x * x + y * y + z * z <= far_squared:
                trace = 0.0
                for k in range(11):
                    if k % 4 != 3:
                        trace += a[i, k] * b[j, k]
                counts[i] += trace >= least_trace
    return counts
