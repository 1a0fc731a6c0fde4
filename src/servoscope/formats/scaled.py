"""Reconstructions, whose unit of length is free: how many metres it has must be said."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.formats.conventions import CONVENTIONS, problem_of_pose
from servoscope.formats.frames import BAD_POSE, Drops
from servoscope.formats.options import ImportOptions

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ScaledOptions(ImportOptions):
    """Options of reconstructions, besides those of every format.

    Parameters
    ----------
    scale : float, optional
        Metres in a unit of the reconstruction, such as a known distance divided by that between
        the same points there; 1 by default, with a warning.

    Examples
    --------
    >>> ScaledOptions(scale=0.21).scale
    0.21
    """

    scale: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_number("scale", above_zero=True)

    def metres(self, where: object) -> float:
        """Metres in a unit; warns where nobody says.

        Warns
        -----
        ServoscopeWarning
            If it is taken to be one.
        """
        if self.scale is not None:
            return self.scale
        if self.units is None:
            warnings.warn(
                f"{where}: the unit of a reconstruction is free, and is taken for a metre; say how "
                "many metres it has with --scale.",
                ServoscopeWarning,
                stacklevel=3,
            )
        return 1e-3 if self.length_unit == "mm" else 1.0


def usable_matrices(
    matrices: Sequence[Array],
    places: Sequence[str],
    names: Sequence[str],
    options: ImportOptions,
    drops: Drops,
) -> NDArray[np.bool_]:
    """Which matrices of 3 x 4 numbers are poses.

    Parameters
    ----------
    matrices : sequence of n ndarray of shape (3, 4)
    places : sequence of n str
        Where each stands, for errors.
    names : sequence of n str
        Of their images.

    Raises
    ------
    DataSetError
        If one is none, unless such are to be left out.
    """
    usable = np.ones(len(matrices), dtype=bool)
    for i, matrix in enumerate(matrices):
        if not np.isfinite(matrix).all():
            problem = "the numbers must be finite"
        else:
            numbers = matrix.ravel().tolist()
            problem = problem_of_pose(numbers, CONVENTIONS["matrix"], length_unit="m")
        if problem and not options.skip_bad:
            raise DataSetError(f"{places[i]}: {problem}, or leave it out with --skip-bad.")
        usable[i] = not problem
    drops.add(BAD_POSE, [name for name, use in zip(names, usable, strict=True) if not use])
    return usable
