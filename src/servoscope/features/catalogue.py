"""The families of image features by name.

A further family needs one line in `FAMILIES`, or an entry point ``servoscope.features``.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

from servoscope.errors import InvalidInputError, PluginError, ServoscopeWarning
from servoscope.features.cell_moments import GradientMoments, IntensityMoments
from servoscope.features.eigenfeatures import Eigenfeatures
from servoscope.features.fixed_projection import (
    ImageProjections,
    LogPolarFeatures,
    TchebichefMoments,
)
from servoscope.features.lfa import LocalFeatureAnalysis
from servoscope.features.moments import GeometricMoments
from servoscope.features.pose_covariance import PoseImageCovariance, PoseLeastSquares
from servoscope.features.robust_moments import RobustMoments
from servoscope.plugins import Registry
from servoscope.wording import listing


@dataclass(frozen=True)
class Family:
    """A family of image features:

    what people call it, what makes an unfitted transformer for so many images to learn from,
    whether it is fitted to images, which that flatters, and whether an assessment computes it
    unless families are named.
    """

    title: str
    make: Callable[[int], Any]
    is_learned: bool = False
    is_default: bool = True


def as_family(name: str, features: Any) -> Family:
    """The family that a transformer makes, or a class or function that makes one.

    Unless it says so itself by an attribute ``is_learned``, it counts as learned. What has no
    ``fit`` and ``transform`` is refused.
    """
    if isinstance(features, Family):
        return features
    is_maker = isinstance(features, type) or not hasattr(features, "transform")
    if is_maker and not callable(features):
        raise InvalidInputError(
            f"The features {name!r} must have fit and transform, or make such an object, got "
            f"{repr(features)[:80]}."
        )

    def make(n_images: int) -> Any:
        made = features() if is_maker else deepcopy(features)
        if not (hasattr(made, "fit") and hasattr(made, "transform")):
            raise InvalidInputError(
                f"The features {name!r} must have fit and transform, got a {type(made).__name__}."
            )
        return made

    title = getattr(features, "title", name)
    return Family(str(title), make, bool(getattr(features, "is_learned", True)))


FAMILIES: Registry[Family] = Registry(
    "servoscope.features",
    {
        "moments": Family("geometric moments", lambda n: GeometricMoments()),
        "eigenfeatures": Family(
            "eigenfeatures", lambda n: Eigenfeatures(min(35, n // 3)), is_learned=True
        ),
        "pose_covariance": Family(
            "pose-image covariance", lambda n: PoseImageCovariance(), is_learned=True
        ),
        "least_squares": Family(
            "partial least squares", lambda n: PoseLeastSquares(min(20, n // 3)), is_learned=True
        ),
        "projections": Family("projections onto lines", lambda n: ImageProjections()),
        "log_polar": Family("log-polar waves", lambda n: LogPolarFeatures()),
        "gradient": Family("gradient orientations in cells", lambda n: GradientMoments()),
        "intensity": Family("intensity slices in cells", lambda n: IntensityMoments()),
        "robust": Family("completed cells", lambda n: RobustMoments()),
        "tchebichef": Family("Tchebichef moments", lambda n: TchebichefMoments(), is_default=False),
        "lfa": Family(
            "local feature analysis",
            lambda n: LocalFeatureAnalysis(min(35, n // 3)),
            is_learned=True,
            is_default=False,
        ),
    },
    as_family,
)
"""The families by name. Left out by default are LFA, which is behind the others in every
measurement, and Tchebichef moments (docs/features.md)."""


def default_families() -> list[str]:
    """Names of the families that an assessment computes by default, plug-ins among them.

    Warns
    -----
    ServoscopeWarning
        If a plug-in cannot be loaded, which is then left out.
    """
    names = [name for name, family in FAMILIES.built_in.items() if family.is_default]
    for name in FAMILIES:
        if name not in FAMILIES.built_in:
            try:
                names += [name] * FAMILIES[name].is_default
            except PluginError as error:
                warnings.warn(f"Left out: {error}", ServoscopeWarning, stacklevel=2)
    return names


def resolve_families(families: Sequence[Any]) -> dict[str, Family]:
    """The families that names and transformers stand for, by name; a transformer is named after its
    class.

    Examples
    --------
    >>> list(resolve_families(["moments", "robust"]))
    ['moments', 'robust']
    """
    found: dict[str, Family] = {}
    for one in families:
        name = one if isinstance(one, str) else type(one).__name__
        if isinstance(one, str) and one not in FAMILIES:
            raise InvalidInputError(
                f"families must be all or taken from {', '.join(FAMILIES)}, got {one!r}."
            )
        if name in found:
            if one == name:
                continue
            raise InvalidInputError(f"Two families are named {name!r}; give each its own class.")
        found[name] = FAMILIES[name] if isinstance(one, str) else as_family(name, one)
    if not found:
        raise InvalidInputError(
            f"families must be all or taken from {', '.join(FAMILIES)}, got none."
        )
    return found


def parse_families(names: str) -> list[str]:
    """The families that a list with commas names; the default ones for ``all``.

    Examples
    --------
    >>> parse_families("moments, robust")
    ['moments', 'robust']
    """
    if names.strip() == "all":
        return default_families()
    return list(resolve_families([name.strip() for name in names.split(",") if name.strip()]))


def title_of(features: str) -> str:
    """What people call a family, or several joined by ``+``.

    Examples
    --------
    >>> title_of("moments"), title_of("moments+log_polar")
    ('geometric moments', 'geometric moments + log-polar waves')
    """
    names = features.split("+")
    titles = [FAMILIES[name].title if name in FAMILIES else name for name in names]
    return " + ".join(titles) if len(titles) < 4 else listing(names)
