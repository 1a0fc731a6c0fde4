"""What a study is to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.data.splits import HONEST_FRACTIONS, PROTOCOLS
from servoscope.errors import InvalidInputError

N_EIGENVECTORS = 85
"""Eigenvectors that the largest family needs, and so the fewest training images but one."""


@dataclass(frozen=True)
class StudyConfig:
    """Settings of a study; the defaults are the paper's.

    Parameters
    ----------
    seed : int
        Seed of the split and of the nets.
    protocols : tuple of {"paper", "honest"}
    n_bins : int
        Equal-width bins of the mutual information.
    n_ranked : int
        Features that are ranked for each dof, and from which the subsets are taken.
    n_thresholds : int
        Thresholds of mutual information, equally spaced from 0 to 1 bit.
    hidden : int
        Hidden units of each net.
    restarts : int
        Nets trained for each result, of which the best on the deciding images stands.
    """

    seed: int = 0
    protocols: tuple[str, ...] = PROTOCOLS
    n_bins: int = 10
    n_ranked: int = 24
    n_thresholds: int = 21
    hidden: int = 30
    restarts: int = 3

    def __post_init__(self) -> None:
        unknown = set(self.protocols) - set(PROTOCOLS)
        if unknown or not self.protocols:
            raise InvalidInputError(
                f"protocols must be taken from {', '.join(PROTOCOLS)}, got {self.protocols}."
            )
        if self.seed < 0:
            raise InvalidInputError(f"seed must not be negative, got {self.seed}.")
        for name in ("n_bins", "n_ranked", "n_thresholds", "hidden", "restarts"):
            if getattr(self, name) < 1:
                raise InvalidInputError(f"{name} must be at least 1, got {getattr(self, name)}.")

    @property
    def thresholds(self) -> NDArray[np.float64]:
        """Thresholds of mutual information, [bits]."""
        return np.linspace(0.0, 1.0, self.n_thresholds)


def check_n_images(n_images: int, protocols: Sequence[str] = PROTOCOLS) -> None:
    """Raise InvalidInputError unless a study of so many images has enough to train on."""
    protocol = "honest" if "honest" in protocols else "paper"
    share = HONEST_FRACTIONS[0] if protocol == "honest" else 1 - HONEST_FRACTIONS[2]
    least = int(np.ceil((N_EIGENVECTORS + 1) / share))
    if n_images < least:
        raise InvalidInputError(
            f"A study needs at least {least} images, since {N_EIGENVECTORS} eigenvectors are "
            f"found from the {share:.0%} that train under the {protocol} protocol; got {n_images}."
        )
