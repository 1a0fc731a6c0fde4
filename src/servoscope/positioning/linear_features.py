"""A pool of image features, each a projection of what one preparation makes of an image."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.positioning.prepared_images import PREPARATIONS

Array = NDArray[np.float64]
Prepared = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class Projection:
    """Features of one preparation: ``components @ (prepared - mean)``.

    Parameters
    ----------
    mean : ndarray of shape (n_values,), float32
    components : ndarray of shape (n_features, n_values), float32
    names : tuple of n_features str
    """

    mean: NDArray[np.float32]
    components: NDArray[np.float32]
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.components.shape != (len(self.names), len(self.mean)):
            raise InvalidInputError(
                f"{len(self.names)} features of {len(self.mean)} values need components of that "
                f"shape, got {self.components.shape}: the arrays are not of one pool."
            )

    def compute(self, prepared: NDArray[np.float32]) -> Array:
        """Features of prepared images of shape (..., n_values)."""
        return ((prepared - self.mean) @ self.components.T).astype(np.float64)


@dataclass(frozen=True, eq=False)
class FeaturePool:
    """Features of images.

    Parameters
    ----------
    projections : dict
        Those of each preparation, by its name in `PREPARATIONS`.

    Examples
    --------
    >>> plain = Projection(np.zeros(4, np.float32), np.eye(4, dtype=np.float32)[:2], ("a", "b"))
    >>> pool = FeaturePool({"grey": plain})
    >>> images = np.full((3, 2, 2), 7, np.uint8)
    >>> pool.of_images(images).shape, pool.only(["b"]).names
    ((3, 2), ('b',))
    """

    projections: Mapping[str, Projection]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the features, in the order of their columns."""
        return tuple(name for part in self.projections.values() for name in part.names)

    def compute(self, prepared: Prepared) -> Array:
        """Features of images that were prepared, (..., n_features)."""
        parts = [part.compute(prepared[name]) for name, part in self.projections.items()]
        return np.concatenate(parts, axis=-1)

    def of_images(self, images: NDArray[np.uint8]) -> Array:
        """Features of images of shape (n, height, width), (n, n_features)."""
        return self.compute({name: prepare_images(images, name) for name in self.projections})

    def only(self, names: Iterable[str]) -> FeaturePool:
        """The pool of some of the features, in the order of this one."""
        wanted, projections = set(names), {}
        for preparation, part in self.projections.items():
            rows = [i for i, name in enumerate(part.names) if name in wanted]
            if rows:
                kept = tuple(part.names[i] for i in rows)
                projections[preparation] = Projection(part.mean, part.components[rows], kept)
        return FeaturePool(projections)

    def to_arrays(self) -> dict[str, NDArray]:
        """The pool as plain arrays with flat names."""
        arrays: dict[str, NDArray] = {"preparations": np.array(list(self.projections), dtype=str)}
        for name, part in self.projections.items():
            arrays[f"{name}.mean"], arrays[f"{name}.components"] = part.mean, part.components
            arrays[f"{name}.names"] = np.array(part.names, dtype=str)
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> FeaturePool:
        """The pool that `to_arrays` was called on.

        Raises
        ------
        InvalidInputError
            If an array is missing, the sizes disagree, or a preparation is not known.
        """
        projections = {}
        for name in _array(arrays, "preparations").astype(str).tolist():
            if name not in PREPARATIONS:
                raise InvalidInputError(
                    f"Images can be prepared as {', '.join(PREPARATIONS)}, got {name!r}."
                )
            projections[name] = Projection(
                _array(arrays, f"{name}.mean").astype(np.float32),
                _array(arrays, f"{name}.components").astype(np.float32),
                tuple(_array(arrays, f"{name}.names").astype(str).tolist()),
            )
        return cls(projections)


def prepare_images(images: NDArray[np.uint8], preparation: str) -> NDArray[np.float32]:
    """What a preparation makes of images of shape (n, height, width), (n, n_values)."""
    return np.stack([PREPARATIONS[preparation](image) for image in images])


def _array(arrays: Mapping[str, ArrayLike], name: str) -> NDArray:
    if name not in arrays:
        raise InvalidInputError(
            f"A pool of features needs the array {name!r}, got {', '.join(sorted(arrays))}."
        )
    return np.asarray(arrays[name])
