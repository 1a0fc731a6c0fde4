"""How accurately a model reads images that were held out."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.poses import DISPLAY_FACTORS, DOFS
from servoscope.positioning.interfaces import Array

LEAST_GAIN = 0.8
"""A dof is observable if its error is at most this share of that of predicting the mean."""

ADVICE = "see that every image belongs to its pose, none late, and that it shows the part"
"""What to do where images predict poses no better than their mean."""

_RIGHT = 0.25
_MOST_OPTIMISTIC = 5.0
_NORMAL_QUANTILE_90 = 1.645


def read_right(errors: Array, reach: Array) -> NDArray[np.bool_]:
    """Which images were read at about the right place, given errors of shape (n, 6)."""
    return np.asarray((np.abs(errors) <= _RIGHT * reach).all(axis=1))


def describe_errors(
    errors: Array, truth: Array, dofs: tuple[str, ...], reach: Array, n_groups: int | None = None
) -> dict[str, Any]:
    """What a model's record says of the errors of images held out, by dof, as plain JSON values.

    Parameters
    ----------
    errors : ndarray of shape (n, 6)
        About the pivot, [m] and [rad]; those of dofs that are not commanded do not count.
    truth : ndarray of shape (n, 6)
        Displacements.
    dofs : tuple of str
        Those that are commanded.
    reach : ndarray of shape (6,)
        The range of displacements.
    n_groups : int, optional
        Of how many independent groups the images are.

    Returns
    -------
    dict
        ``rms`` of the images that are read right, ``median`` and ``quantile_90`` of all, in mm and
        degrees; ``error_shares``, the RMS errors of all as shares of those of predicting the mean
        of the truth; ``held_out``, the number of ``images``, of ``groups``, and ``share_right``.
    """
    is_commanded = np.isin(DOFS, dofs)
    sizes = np.abs(errors) * is_commanded
    right = read_right(sizes, reach)
    rms = np.sqrt(np.mean(errors[right if right.any() else ...] ** 2, axis=0))
    shares = np.sqrt(np.mean(errors**2, axis=0)) / np.maximum(truth.std(axis=0), 1e-12)
    return {
        "rms": _by_dof(rms * DISPLAY_FACTORS, dofs),
        "held_out": {
            "images": len(errors),
            "share_right": float(right.mean()),
            **({} if n_groups is None else {"groups": n_groups}),
        },
        "error_shares": _by_dof(shares, dofs),
        "median": _by_dof(np.median(sizes, axis=0) * DISPLAY_FACTORS, dofs),
        "quantile_90": _by_dof(np.quantile(sizes, 0.9, axis=0) * DISPLAY_FACTORS, dofs),
    }


def deviation_factor(errors: Array, std: Array) -> Array:
    """By how much standard deviations of images held out were too small, by dof; 1 at least."""
    if not len(errors):
        return np.full(errors.shape[1], _MOST_OPTIMISTIC)
    ratio = np.quantile(np.abs(errors) / std, 0.9, axis=0) / _NORMAL_QUANTILE_90
    return np.asarray(np.clip(ratio, 1.0, _MOST_OPTIMISTIC))


def is_of_use(error_shares: Mapping[str, float]) -> bool:
    """Whether half of the dofs or more are predicted better than by their mean."""
    return 2 * len(_unobservable(error_shares)) <= len(error_shares)


def check_use(error_shares: Mapping[str, float]) -> None:
    """Refuse what predicts images held out no better than by their mean in most dofs.

    Parameters
    ----------
    error_shares : mapping of str to float
        By dof: RMS error of images held out, as a share of that of their mean.

    Raises
    ------
    DataSetError
    """
    if not is_of_use(error_shares):
        raise DataSetError(f"{_found(error_shares)}; no robot may be moved by that: {ADVICE}.")


def check_observable(error_shares: Mapping[str, float]) -> None:
    """Say which dofs a model cannot predict, or refuse one that is of no use.

    Parameters
    ----------
    error_shares : mapping of str to float
        As of `check_use`.

    Raises
    ------
    DataSetError
        If most dofs are predicted no better than by the mean.

    Warns
    -----
    ServoscopeWarning
        If some are.
    """
    check_use(error_shares)
    if _unobservable(error_shares):
        warnings.warn(
            f"{_found(error_shares)}; rely on no accuracy in these dofs: {ADVICE}.",
            ServoscopeWarning,
            stacklevel=3,
        )


def _found(error_shares: Mapping[str, float]) -> str:
    shown = ", ".join(f"{dof} {error_shares[dof]:.2f}" for dof in _unobservable(error_shares))
    return (
        f"Images held out are predicted hardly better than by their mean in {shown} (error as a "
        f"share of the mean's, at most {LEAST_GAIN:g})"
    )


def _unobservable(error_shares: Mapping[str, float]) -> list[str]:
    return [dof for dof, share in error_shares.items() if not share < LEAST_GAIN]


def _by_dof(values: Array, dofs: tuple[str, ...]) -> dict[str, float]:
    by_dof = dict(zip(DOFS, map(float, values), strict=True))
    return {dof: by_dof[dof] for dof in dofs}
