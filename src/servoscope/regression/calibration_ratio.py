"""How much larger errors are than they were expected to be."""

from __future__ import annotations

import numpy as np

from servoscope.regression.samples import Array


def calibration_ratio(errors: Array, expected: Array) -> float:
    """RMS of errors, each in units of the standard deviation that was expected of it.

    It is 1 where nothing can be said: where there are no errors at all, or none were expected.

    Examples
    --------
    >>> calibration_ratio(np.array([3.0, -8.0]), np.array([1.5, 4.0]))
    2.0
    """
    if not expected.all() or not errors.any():
        return 1.0
    return float(np.sqrt(np.mean((errors / expected) ** 2)))
