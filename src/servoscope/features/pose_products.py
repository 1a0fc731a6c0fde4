"""Displacements as targets of linear features, with the products of two of them."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from servoscope.features.image_transformer import target_names

Array = NDArray[np.float64]


def centred_targets(delta_p: Array, products: bool) -> Array:
    """Displacements about their mean and, if wished, their products of two about theirs.

    Parameters
    ----------
    delta_p : ndarray of shape (n_images, n_targets)
    products : bool

    Returns
    -------
    ndarray of shape (n_images, n_targets) or (n_images, n_targets * (n_targets + 3) / 2)
        In the order of `product_names`. The products are those of the centred displacements,
        the second-order terms of how an image depends on its pose.

    Examples
    --------
    >>> centred_targets(np.array([[1.0], [2.0], [6.0]]), products=True)
    array([[-2.        , -0.66666667],
           [-1.        , -3.66666667],
           [ 3.        ,  4.33333333]])
    """
    centred = delta_p - delta_p.mean(axis=0)
    if not products:
        return centred
    pairs = combinations_with_replacement(range(centred.shape[1]), 2)
    terms = np.stack([centred[:, i] * centred[:, j] for i, j in pairs], axis=1)
    return np.hstack([centred, terms - terms.mean(axis=0)])


def product_names(n_targets: int, products: bool) -> list[str]:
    """Names of the columns of `centred_targets`.

    Examples
    --------
    >>> product_names(2, products=True)
    ['0', '1', '0_0', '0_1', '1_1']
    >>> product_names(6, products=True)[7]
    'tx_ty'
    """
    names = target_names(n_targets)
    pairs = combinations_with_replacement(names, 2) if products else ()
    return names + ["_".join(pair) for pair in pairs]
