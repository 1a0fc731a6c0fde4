"""Images with the camera poses that they were taken from."""

from __future__ import annotations

import base64
import hashlib
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from os import PathLike
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.data import folder as dataset_folder
from servoscope.dofs import check_dofs, moving_dofs
from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.poses import (
    DISPLAY_FACTORS,
    DISPLAY_UNITS,
    DOFS,
    FARTHEST,
    check_displacement,
    displacement_ranges,
    displacements_from_poses,
    inverse_transform,
    is_rigid,
    pose_error,
)
from servoscope.storage.sizes import parse_bytes
from servoscope.storage.stacks import blocks_of, some_of

SPLITS = ("random", "blocks")
"""How a set may be split: at random, or by blocks of time for images of one sequence."""

_IMAGES_SHARE = 4


def images_share(memory: str | None) -> float:
    """Bytes of images that are kept in a memory such as "1GB" at once: a quarter of it.

    Examples
    --------
    >>> images_share("2GB")
    500000000.0
    """
    return np.inf if memory is None else parse_bytes(memory) / _IMAGES_SHARE


_HELD_SHARE, _LEAST_KEPT = 3, 200
_OUTLYING, _MOST_OUTLIERS = 2.0, 0.05
_SAME_POSE = 1e-6  # metres and radians, as pose files are written
_MOST_NOISE = 64.0


@dataclass(frozen=True, eq=False, repr=False)
class PoseImageSet:
    """Images, the pose each was taken from, and the reference that displacements start at.

    Parameters
    ----------
    images : ndarray of shape (n_images, height, width), uint8
        Or a `servoscope.storage.stacks.Stack`, where they are too many for the memory.
    T_world_cam : ndarray of shape (n_images, 4, 4)
        Camera to world, [m].
    T_world_ref : ndarray of shape (4, 4)
        Camera pose of the reference, [m].
    reference_image : ndarray of shape (height, width), uint8
    names : sequence of n_images str, optional
        One unique name an image; numbered by default.
    pivot : float
        Distance of the pivot from the camera along the optical axis, [m].
    pivot_ranges : ndarray of shape (6,), optional
        Half-widths of the displacements that were sampled about the pivot, [m] and [rad]; found
        from the displacements by default, see `ranges`.
    times : ndarray of shape (n_images,), optional
        When each image was taken, [s].
    split : {"random", "blocks"}
        How the set is to be split for training and testing. Images of one sequence want
        ``"blocks"``: at random, neighbouring frames would leak from training to test.
    source : dict
        Where the images come from, as plain JSON values.
    asked_dofs : tuple of str, optional
        The degrees of freedom that count, instead of those that are found to move; see `dofs`.

    Raises
    ------
    DataSetError
        If the shapes disagree, a pose is not finite or not rigid, or a name stands twice.

    Examples
    --------
    >>> import numpy as np
    >>> images = np.zeros((2, 8, 8), np.uint8)
    >>> poses = np.stack([np.eye(4)] * 2)
    >>> poses[1, 0, 3] = 0.01
    >>> data = PoseImageSet(images, poses, np.eye(4), images[0], pivot=0.55)
    >>> data.delta_p()[1]
    array([0.01, 0.  , 0.  , 0.  , 0.  , 0.  ])
    >>> data[:1] + data[1:]
    PoseImageSet(2 images of 8 x 8, 1 dof moves, range 10 mm)
    """

    images: NDArray[np.uint8]
    T_world_cam: NDArray[np.float64]
    T_world_ref: NDArray[np.float64]
    reference_image: NDArray[np.uint8]
    names: Sequence[str] = ()
    pivot: float = 0.55
    pivot_ranges: NDArray[np.float64] | None = None
    times: NDArray[np.float64] | None = None
    split: str = "random"
    source: dict[str, Any] = field(default_factory=dict)
    asked_dofs: tuple[str, ...] = ()

    __array_ufunc__ = None  # an array does not add itself to each image

    def __post_init__(self) -> None:
        if not self.names:
            object.__setattr__(self, "names", [f"{i:06d}" for i in range(len(self.images))])
        _check(self)

    def __len__(self) -> int:
        return len(self.images)

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width of the images, [px]."""
        return self.images.shape[1], self.images.shape[2]

    def delta_p(self, displacement: str = "pivot") -> NDArray[np.float64]:
        """Displacement of every image from the reference.

        Parameters
        ----------
        displacement : {"pivot", "camera"}
            About the pivot, or of the camera itself.

        Returns
        -------
        ndarray of shape (n_images, 6)
            [m] and [rad], in `DOFS` order.
        """
        pivot = self.pivot if check_displacement(displacement) == "pivot" else 0.0
        return displacements_from_poses(self.T_world_ref, self.T_world_cam, pivot)

    @cached_property
    def dofs(self) -> tuple[str, ...]:
        """The degrees of freedom that the robot has, in `DOFS` order.

        Those that were asked for, or else those that move by more than the noise of encoders.
        """
        return self.asked_dofs or moving_dofs(self.delta_p(), self.pivot)

    def moves(self, displacement: str = "pivot") -> NDArray[np.bool_]:
        """Whether each dof moves at all in the set, shape (6,); rounding does not count."""
        return np.ptp(self.delta_p(displacement), axis=0) > 1e-9

    @property
    def image_noise(self) -> float | None:
        """Standard deviation of the noise of one image, [grey], where it was measured."""
        noise = self.source.get("image_noise")
        if isinstance(noise, bool) or not isinstance(noise, int | float):
            return None
        return float(noise) if 0 < noise < _MOST_NOISE else None

    def ranges(self, displacement: str = "pivot") -> NDArray[np.float64]:
        """Half-width of each dof's displacements, by which targets are scaled to [-1, 1].

        The sampled ranges where they are known, else the largest displacement in the set but
        for outliers: 5 % of the images at most, of all dofs together, more than twice as far away
        as all others. 1 for a dof that never moves.

        Returns
        -------
        ndarray of shape (6,)
            [m] and [rad], in `DOFS` order.
        """
        if self.pivot_ranges is None:
            ranges = _largest_but_outliers(np.abs(self.delta_p(displacement)))
        else:
            ranges = displacement_ranges(self.pivot_ranges, self.pivot, displacement)
        return np.where(ranges > 1e-9, ranges, 1.0)

    def fingerprint(self) -> str:
        """A hash of the images, their poses and times, and the reference: 16 hexadecimal digits."""
        content = hashlib.sha256()
        for block in blocks_of(self.images):
            content.update(np.ascontiguousarray(block).data)
        for array in (self.T_world_cam, self.T_world_ref, self.reference_image):
            content.update(np.ascontiguousarray(array).data)
        times = None if self.times is None else self.times.tolist()
        content.update(repr((self.pivot, self.split, times, self.ranges().tolist())).encode())
        return content.hexdigest()[:16]

    def subset(self, indices: NDArray[np.integer]) -> PoseImageSet:
        """The images of some indices, in their order; all else is kept. This set, if these are all.

        Examples
        --------
        >>> images, poses = np.zeros((3, 8, 8), np.uint8), np.tile(np.eye(4), (3, 1, 1))
        >>> data = PoseImageSet(images, poses, np.eye(4), images[0], names=["a", "b", "c"])
        >>> list(data.subset(np.array([2, 0])).names)
        ['c', 'a']
        """
        if not len(indices):
            raise DataSetError(f"No image is left of {len(self)}; a data set has one at least.")
        if np.array_equal(indices, np.arange(len(self))):
            return self
        return replace(
            self,
            images=some_of(self.images, indices),
            T_world_cam=self.T_world_cam[indices],
            names=[self.names[int(i)] for i in indices],
            times=None if self.times is None else self.times[indices],
        )

    def thinned(self, most: int, memory: str | None = None) -> PoseImageSet:
        """At most so many of the images, evenly spread in time, in memory.

        Of images so large that a third of a memory such as "1GB" holds less, they are as many as
        that, but 200 at the least: work on them takes two copies. Images that have no times are in
        the order of time. The source of the fewer notes how many there were, as ``thinned_from``.

        Examples
        --------
        >>> images, poses = np.zeros((9, 8, 8), np.uint8), np.tile(np.eye(4), (9, 1, 1))
        >>> data = PoseImageSet(images, poses, np.eye(4), images[0], names=list("abcdefghi"))
        >>> list(data.thinned(3).names)
        ['a', 'e', 'i']
        """
        if memory is not None:
            third = parse_bytes(memory) / _HELD_SHARE
            held = max(int(third / self.reference_image.nbytes), _LEAST_KEPT)
            if held < min(len(self), most):
                warnings.warn(
                    f"Of {len(self)} images {held} are used, as many as {memory} of memory allow; "
                    "give more (--memory), or take smaller images.",
                    ServoscopeWarning,
                    stacklevel=2,
                )
                most = held
        kept = self
        if len(self) > most:
            order = np.arange(len(self))
            if self.times is not None:
                order = np.argsort(self.times, kind="stable")
            even = np.linspace(0, len(self) - 1, most).round().astype(np.intp)
            kept = self.subset(np.sort(order[even]))
            kept = replace(kept, source={"thinned_from": len(self), **self.source})
        in_memory = isinstance(kept.images, np.ndarray)
        return kept if in_memory else replace(kept, images=np.asarray(kept.images))

    def __getitem__(self, index: Any) -> PoseImageSet:
        """The images of a slice, of a mask with one bool an image, or of an array of indices.

        Raises
        ------
        IndexError
            If an index is beyond the images, or is none.
        """
        chosen = np.asarray(index) if not isinstance(index, slice | int) else index
        if isinstance(chosen, np.ndarray) and not (chosen.size or chosen.dtype == bool):
            chosen = chosen.astype(np.intp)
        try:
            return self.subset(np.atleast_1d(np.arange(len(self))[chosen]).ravel())
        except IndexError as error:
            raise IndexError(
                f"Choose of {len(self)} images by a slice, by {len(self)} bools, or by whole "
                f"numbers from {-len(self)} to {len(self) - 1}: {error}."
            ) from None

    def without(self, names: str | Iterable[str]) -> PoseImageSet:
        """All images but those of some names.

        Raises
        ------
        DataSetError
            If there is no image of a name, or none is left.
        """
        left_out = {names} if isinstance(names, str) else set(names)
        if unknown := sorted(left_out - set(self.names)):
            raise DataSetError(
                f"No image is named {unknown[0]!r}; names are like {self.names[0]!r}."
            )
        return self.subset(np.flatnonzero([name not in left_out for name in self.names]))

    def __add__(self, other: PoseImageSet) -> PoseImageSet:
        """The images of both sets, about the reference of the first.

        The reference is the same if its pose is, as of another day or lamp: the poses are kept,
        and so is the reference image of this set. It is also if its image is: poses of the other
        set are then moved along with its reference, which keeps their displacements. Names that
        this set has too get a suffix, and times that overlap are put after its own. Times are
        kept if both sets have them; without, images are in the order of time.

        Raises
        ------
        DataSetError
            If the references, the image shapes or the pivots differ.
        """
        if not isinstance(other, PoseImageSet):
            return NotImplemented
        poses = _about_the_same_reference(self, other)
        first, second, times = self, other, None
        if self.times is not None and other.times is not None:
            is_after = other.times.min() > self.times.max()
            gap = 0.0 if is_after else self.times.max() - other.times.min() + 1.0
            times = np.concatenate([self.times, other.times + gap])
        else:
            first, second, poses = _in_order_of_time(self, other, poses)
        ranges = None
        if self.pivot_ranges is not None or other.pivot_ranges is not None:
            ranges = np.maximum(_own_ranges(self), _own_ranges(other))
        is_sequence = "blocks" in (self.split, other.split)
        added = {"n_images": len(other), "source": other.source}
        return replace(
            self,
            images=np.concatenate([first.images, second.images]),
            T_world_cam=np.concatenate([first.T_world_cam, poses]),
            names=[*first.names, *_new_names(second.names, first.names)],
            times=times,
            pivot_ranges=ranges,
            split="blocks" if is_sequence else "random",
            source={**self.source, "added": [*self.source.get("added", []), added]},
        )

    @classmethod
    def append(cls, folder: str | PathLike[str], data: PoseImageSet) -> PoseImageSet:
        """Add images to a data set folder, which stays as it was until the new one is whole.

        Returns
        -------
        PoseImageSet
            What the folder holds then: ``PoseImageSet.load(folder) + data``.

        Raises
        ------
        DataSetError
            If the folder holds no data set, or the two do not fit together, see `__add__`.
        FolderInUseError
            If another command is writing there.
        """
        dataset_folder.read_meta(folder)
        with dataset_folder.writing(folder, replace=True) as place:
            joined = cls.load(folder) + data
            joined.save(place)
        return joined

    def __repr__(self) -> str:
        return as_text(self)

    def _repr_html_(self) -> str:
        return as_html(self)

    def save(self, folder: str | PathLike[str]) -> None:
        """Write a data set folder; see `docs/conventions.md` for its layout.

        Raises
        ------
        FolderExistsError
            If the folder holds a data set already.
        """
        n_images = len(self.images)
        dataset_folder.create(folder, n_images, self.image_shape)
        start = 0
        for block in blocks_of(self.images):
            dataset_folder.write_images(folder, start, block)
            start += len(block)
        dataset_folder.finish(
            folder,
            reference_image=self.reference_image,
            T_world_ref=self.T_world_ref,
            T_world_cam=self.T_world_cam,
            names=self.names,
            times=self.times,
            meta={
                "pivot": self.pivot,
                "pivot_ranges": None if self.pivot_ranges is None else list(self.pivot_ranges),
                "split": self.split,
                "source": self.source,
                **({"dofs": list(self.asked_dofs)} if self.asked_dofs else {}),
            },
        )

    @classmethod
    def load(cls, folder: str | PathLike[str], *, memory: str | None = None) -> PoseImageSet:
        """Read a data set folder.

        Parameters
        ----------
        folder : path-like
            Or an address that fsspec reads, such as ``s3://bucket/set``: images are fetched from
            there as they are needed.
        memory : str, optional
            Such as "1GB": images that take more than a quarter of it stay on disk, and are read
            where they are asked for. By default all are read.

        Raises
        ------
        DataSetError
            If the folder is missing, unfinished, damaged or of another version.
        """
        content = dataset_folder.read(folder, images_share(memory))
        meta = content.pop("meta")
        ranges = meta["pivot_ranges"]
        try:
            return cls(
                **content,
                pivot=float(meta["pivot"]),
                pivot_ranges=None if ranges is None else np.array(ranges, dtype=float),
                split=meta["split"],
                source=meta["source"],
                asked_dofs=tuple(meta.get("dofs", ())),
            )
        except (TypeError, ValueError) as error:
            raise DataSetError(f"{folder} does not hold together: {error}") from error


def _about_the_same_reference(data: PoseImageSet, other: PoseImageSet) -> NDArray[np.float64]:
    """The poses of another set in the world of the first, (n, 4, 4)."""
    for what, ours, theirs in (
        ("images of {1} x {0} px", data.image_shape, other.image_shape),
        ("a pivot {0:g} m before the camera", (data.pivot,), (other.pivot,)),
    ):
        if not np.allclose(ours, theirs, rtol=0, atol=1e-9):
            raise DataSetError(
                f"Two sets join if they are alike, but one has {what.format(*ours)} and the other "
                f"{what.format(*theirs)}; make them anew with the same."
            )
    metres, angle = pose_error(data.T_world_ref, other.T_world_ref)
    if max(metres, angle) < _SAME_POSE:
        return other.T_world_cam
    if np.array_equal(data.reference_image, other.reference_image):
        return data.T_world_ref @ inverse_transform(other.T_world_ref) @ other.T_world_cam
    raise DataSetError(
        "Two sets join if their references are of one pose or of one image, but these are "
        f"{1e3 * metres:.3g} mm and {np.degrees(angle):.3g} deg apart, and the images differ; "
        "take or import both about the same reference."
    )


def _in_order_of_time(
    data: PoseImageSet, other: PoseImageSet, poses: NDArray[np.float64]
) -> tuple[PoseImageSet, PoseImageSet, NDArray[np.float64]]:
    """Two sets, and poses of the second, each in the order of its times if it has any."""
    orders = [
        np.arange(len(one)) if one.times is None else np.argsort(one.times, kind="stable")
        for one in (data, other)
    ]
    return data.subset(orders[0]), other.subset(orders[1]), poses[orders[1]]


def _own_ranges(data: PoseImageSet) -> NDArray[np.float64]:
    if data.pivot_ranges is not None:
        return data.pivot_ranges
    return np.where(data.moves(), data.ranges(), 0.0)


def _new_names(names: Iterable[str], taken: Iterable[str]) -> list[str]:
    """The names, with a number behind those that are taken."""
    known, new = set(taken), []
    originals = set(names := list(names))
    for name in names:
        fresh, number = name, 2
        while fresh in known or (fresh != name and fresh in originals):
            fresh, number = f"{name}_{number}", number + 1
        known.add(fresh)
        new.append(fresh)
    return new


def _largest_but_outliers(sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest of each column below a gap of a factor of two, if few rows are above any."""
    n = len(sizes)
    if n < 2:
        return np.asarray(sizes.max(axis=0))
    most = min(max(1, int(_MOST_OUTLIERS * n)), n - 1)
    ordered = np.sort(sizes, axis=0)[n - most - 1 :]
    below, above = ordered[:-1], ordered[1:]
    is_gap = (above > _OUTLYING * below) & (below > 1e-9)
    first = np.where(is_gap.any(axis=0), is_gap.argmax(axis=0), most)
    largest = np.take_along_axis(ordered, first[None], axis=0)[0]
    if (sizes > largest).any(axis=1).sum() > most:
        return np.asarray(sizes.max(axis=0))
    return np.asarray(largest)


def _check(data: PoseImageSet) -> None:
    _check_arrays(data)
    n_images = len(data.images)
    if len(data.names) != n_images or len(set(data.names)) != n_images:
        raise DataSetError(
            f"names must be {n_images} different names, one an image, got {len(data.names)} "
            f"with {len(set(data.names))} different ones."
        )
    if not abs(data.pivot) <= FARTHEST:
        raise DataSetError(f"pivot must be a finite distance in metres, got {data.pivot}.")
    if data.pivot_ranges is not None and not (data.pivot_ranges >= 0).all():
        raise DataSetError(f"pivot_ranges must not be below 0, got {data.pivot_ranges.tolist()}.")
    if not isinstance(data.source, dict):
        raise DataSetError(f"source must be a dict, got a {type(data.source).__name__}.")
    if data.asked_dofs:
        object.__setattr__(data, "asked_dofs", check_dofs(data.asked_dofs))
    if data.split not in SPLITS:
        raise DataSetError(f"split must be one of {', '.join(SPLITS)}, got {data.split!r}.")


def _check_arrays(data: PoseImageSet) -> None:
    images, n_images = data.images, len(data.images)
    if images.dtype != np.uint8 or images.ndim != 3 or not n_images:
        raise DataSetError(
            "images must be a uint8 array of shape (n_images, height, width) with at least one "
            f"image, got {images.dtype} of shape {images.shape}."
        )
    expected: dict[str, tuple[NDArray[Any], tuple[int, ...]]] = {
        "T_world_cam": (data.T_world_cam, (n_images, 4, 4)),
        "T_world_ref": (data.T_world_ref, (4, 4)),
        "reference_image": (data.reference_image, images.shape[1:]),
    }
    if data.times is not None:
        expected["times"] = (data.times, (n_images,))
    if data.pivot_ranges is not None:
        expected["pivot_ranges"] = (data.pivot_ranges, (6,))
    for name, (array, shape) in expected.items():
        if array.shape != shape:
            raise DataSetError(f"{name} must have the shape {shape}, got {array.shape}.")
        if not np.isfinite(array).all():
            raise DataSetError(f"{name} must be finite, but holds NaN or infinity.")
    if data.reference_image.dtype != np.uint8:
        raise DataSetError(f"reference_image must be uint8, got {data.reference_image.dtype}.")
    for name in ("T_world_cam", "T_world_ref"):
        if np.abs(getattr(data, name)).max() > FARTHEST:
            raise DataSetError(
                f"{name} must lie within {FARTHEST:g} m; check that its translations are in metres."
            )
        if not is_rigid(getattr(data, name)):
            raise DataSetError(
                f"{name} must hold rigid transforms, but one of them is none: its rotation is not "
                "orthonormal, it mirrors, or its last row is not 0 0 0 1."
            )


_THUMBNAIL = 128


def as_text(data: PoseImageSet) -> str:
    """How many images of which size, what moves, and how far."""
    height, width = data.image_shape
    moves, ranges = data.moves(), data.ranges() * DISPLAY_FACTORS
    n = int(moves.sum())
    parts = [
        f"{len(data)} image{'s' * (len(data) != 1)} of {width} x {height}",
        f"{n or 'no'} dof{'s' * (n > 1)} move{'s' * (n < 2)}",
    ]
    spans = [
        f"{ranges[kind][moves[kind]].max():.3g} {unit}"
        for kind, unit in ((slice(0, 3), "mm"), (slice(3, 6), "deg"))
        if moves[kind].any()
    ]
    if spans:
        parts.append(f"range {', '.join(spans)}")
    return f"PoseImageSet({', '.join(parts)})"


def as_html(data: PoseImageSet) -> str:
    """A table of what a data set holds beside its reference image; all text is escaped."""
    height, width = data.image_shape
    rows = {
        "images": f"{len(data)} of {width} x {height} px",
        "names": f"{data.names[0]} ... {data.names[-1]}",
        "pivot": f"{1e3 * data.pivot:g} mm",
        "split": data.split,
    }
    for dof, moves, value, unit in zip(
        DOFS, data.moves(), data.ranges() * DISPLAY_FACTORS, DISPLAY_UNITS, strict=True
    ):
        rows[dof] = f"{value:.3g} {unit}" if moves else "does not move"
    cells = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in rows.items()
    )
    scale = min(1.0, _THUMBNAIL / max(height, width))
    size = max(1, round(scale * width)), max(1, round(scale * height))
    small = cv2.resize(data.reference_image, size, interpolation=cv2.INTER_AREA)
    png = base64.b64encode(cv2.imencode(".png", small)[1].tobytes()).decode()
    picture = f'<img alt="reference image" src="data:image/png;base64,{png}">'
    return f"<table>{cells}<tr><th>reference</th><td>{picture}</td></tr></table>"
