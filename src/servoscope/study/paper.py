"""The study of Wells and Torras (2001) as data: its settings, its families and its tables.

The names of features are ours: ``theta_50`` is the paper's theta with the superscript 50,
``e_07`` its e_7, ``pci_rz`` its PCI vector of Rz.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.data.splits import HONEST_FRACTIONS, PROTOCOLS
from servoscope.errors import InvalidInputError
from servoscope.features.catalogue import title_of
from servoscope.pipeline import Recipe

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


NETS = "levenberg_marquardt"


@dataclass(frozen=True)
class PaperFamily:
    """A family of features of Table I:

    the paper's title, what its nets take, the prefix of the names of its features, what stands
    before these so that families differ without colour too, how charts show it, and its name in
    words, that of the catalogue by default.
    """

    title: str
    recipe: Recipe
    prefix: str
    sign: str
    color: str
    marker: str
    name: str = ""

    @property
    def words(self) -> str:
        """What it is called in full."""
        return self.name or title_of(str(self.recipe.features))

    @property
    def style(self) -> dict[str, str]:
        """How a chart shows it."""
        return {"color": self.color, "marker": self.marker}


FAMILIES = {
    "gm": PaperFamily("GM", Recipe("moments", regressor=NETS), "", "●", "#12314f", "o"),
    "pca": PaperFamily(
        "PCA", Recipe("eigenfeatures", ("e_[01]?", "e_2[0-3]"), NETS), "e", "□", "#7f97ab", "s"
    ),
    "pci": PaperFamily(
        "PCI", Recipe("pose_covariance", regressor=NETS), "pci", "▲", "#b3501e", "^"
    ),
    **{
        f"lfa{n}": PaperFamily(
            f"LFA ({n} ev)",
            Recipe(f"lfa{n}", (f"lfa{n}_{{dof}}_*",), NETS),
            f"lfa{n}",
            "◆",
            *look,
            name=f"{title_of('lfa')}, {n} eigenvectors",
        )
        for n, look in ((35, ("#9aa58c", "D")), (85, ("#55624a", "v")))
    },
}
"""The families of Table I: geometric moments, 24 eigenfeatures, the pose-image covariance, and
local features from 35 and from 85 eigenvectors."""


def family_of(feature: str) -> str:
    """The family of a feature, by the beginning of its name.

    Examples
    --------
    >>> [family_of(name) for name in ("theta_50", "e_07", "pci_rz", "lfa35_tx_00")]
    ['gm', 'pca', 'pci', 'lfa35']
    """
    prefix = feature.split("_")[0]
    return next((name for name, family in FAMILIES.items() if family.prefix == prefix), "gm")


_COLUMNS = ("rz", "rx", "ry", "tz", "tx", "ty")


def _row(*values: float) -> dict[str, float]:
    return dict(zip(_COLUMNS, values, strict=True))


TABLE1 = {
    "gm": _row(0.03, 0.05, 0.07, 0.14, 0.07, 0.05),
    "pca": _row(0.10, 0.20, 0.22, 0.41, 0.29, 0.29),
    "pci": _row(0.09, 0.11, 0.18, 0.32, 0.25, 0.14),
    "lfa35": _row(0.15, 0.25, 0.19, 0.39, 0.29, 0.24),
    "lfa85": _row(0.21, 0.39, 0.24, 0.44, 0.32, 0.29),
}
"""Table I: RMS test errors of targets scaled to [-1, 1], by family and dof."""

TABLE2 = {
    "rz": "theta_50 pci_rz theta_150 sy_50 e_01 e_06 theta_100 sy_150 e_08 e_31 e_? e_20 e_29 "
    "e_11 sy_100 e_21 e_33 e_32 e_26 r2_150 e_28 e_16 sx_150 e_25",
    "rx": "r2_100 y_150 sy_100 m00_150 sx_150 m00_100 y_100 pci_tz theta_50 r2_150 e_00 e_21 "
    "sx_100 e_19 sy_150 pci_rx r2_50 e_29 m00_50 sy_50 e_18 x_100 e_30 e_07",
    "ry": "r1_50 r1_150 m00_150 x_100 e_05 sx_50 m00_100 r2_150 x_50 e_11 e_02 e_21 x_150 e_04 "
    "e_08 r1_100 sy_100 sy_50 e_03 e_10 sx_150 pci_ry sx_100 y_50",
    "tz": "e_21 r1_100 sy_150 r2_50 e_31 sx_150 e_29 m00_50 sx_100 e_32 e_18 r2_150 m00_100 e_28 "
    "x_150 e_09 e_26 e_13 y_100 sy_50 e_16 sx_50 e_30 sy_100",
    "tx": "e_07 sx_100 e_34 e_17 m00_50 e_13 sx_150 e_10 m00_150 e_22 y_100 r1_100 e_15 sy_100 "
    "e_19 x_150 e_29 e_14 e_11 e_28 e_08 e_31 sy_150 e_05",
    "ty": "y_50 theta_50 e_30 e_18 e_10 e_21 pci_rx e_15 e_11 e_31 sy_100 e_26 e_29 e_20 pci_tz "
    "m00_50 e_17 e_22 sx_150 y_150 e_34 e_07 e_28 r2_100",
}
"""Table II: the first 24 features of each dof; one number is illegible and stands as ``e_?``."""

TABLE3 = {
    dof: {"rms": rms, "n_features": n}
    for dof, rms, n in zip(
        _COLUMNS, (0.03, 0.05, 0.08, 0.19, 0.16, 0.09), (5, 10, 16, 24, 24, 7), strict=True
    )
}
"""Table III: least RMS test error of the minimum subsets, and how many features they hold."""


def table2(dof: str) -> list[str]:
    """The published ranking of a dof, most informative first."""
    return TABLE2[dof].split()
