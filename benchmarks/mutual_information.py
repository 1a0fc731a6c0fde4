"""Mutual information of all features with all dofs and with each other."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations_with_replacement, product

import numpy as np
from sklearn.feature_selection import mutual_info_regression
from sklearn.metrics import mutual_info_score

import servoscope as sv
from benchmarks.timing import Contender, Table, race
from servoscope.selection import bin_codes

N_FEATURES, N_DOFS, N_BINS = 65, 6, 10
N_PAIRS = N_FEATURES * N_DOFS + N_FEATURES * (N_FEATURES + 1) // 2

TARGETS = {1000: 0.010, 100_000: 0.4}
"""The most that we may take, by the number of samples, [s]."""


def tables(quick: bool) -> Iterator[Table]:
    """One table for each number of samples."""
    for n_samples, target in list(TARGETS.items())[: 1 if quick else None]:
        X, Y = _correlated(n_samples)
        yield Table(
            "Mutual information",
            f"{N_FEATURES} features x {N_DOFS} dofs and {N_FEATURES} x {N_FEATURES} pairs of "
            f"{n_samples} samples, {N_BINS} bins, one thread (target: {target} s)",
            race(_contenders(X, Y), repeats=5 if quick else 11),
        )


def _correlated(n_samples: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    Y = rng.uniform(-1, 1, (n_samples, N_DOFS))
    noise = rng.normal(size=(n_samples, N_FEATURES))
    return Y @ rng.normal(size=(N_DOFS, N_FEATURES)) + noise, Y


def _contenders(X: np.ndarray, Y: np.ndarray) -> list[Contender]:
    codes = bin_codes(np.hstack([X, Y]), N_BINS)
    features, dofs = codes[:N_FEATURES], codes[N_FEATURES:]
    pairs = [*product(features, dofs), *combinations_with_replacement(features, 2)]
    n_scored, n_neighbours = (40, 10) if len(X) <= 1000 else (10, 2)
    scored = pairs[:: N_PAIRS // n_scored]
    columns = [*product(X.T, Y.T), *combinations_with_replacement(X.T, 2)]
    counted = columns[:: N_PAIRS // n_scored]
    _check_agreement(X, Y, features, dofs)
    return [
        Contender("servoscope", lambda: _ours(X, Y), remark="binning included"),
        Contender(
            "numpy.histogram2d",
            lambda: [np.histogram2d(a, b, N_BINS) for a, b in counted],
            N_PAIRS / len(counted),
            "counts only",
        ),
        Contender(
            "sklearn mutual_info_score",
            lambda: [mutual_info_score(a, b) for a, b in scored],
            N_PAIRS / len(scored),
            "same estimate to 1e-12; binning not counted",
        ),
        Contender(
            "sklearn mutual_info_regression",
            lambda: mutual_info_regression(X[:, :n_neighbours], Y[:, 0], random_state=0),
            N_PAIRS / n_neighbours,
            "another estimate (nearest neighbours)",
        ),
    ]


def _ours(X: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return sv.mutual_information(X, Y, N_BINS), sv.pairwise_mutual_information(X, N_BINS)


def _check_agreement(X: np.ndarray, Y: np.ndarray, features: np.ndarray, dofs: np.ndarray) -> None:
    relevance, pairwise = _ours(X, Y)
    assert abs(relevance[7, 2] - mutual_info_score(features[7], dofs[2]) / np.log(2)) < 1e-12
    assert abs(pairwise[7, 40] - mutual_info_score(features[7], features[40]) / np.log(2)) < 1e-12
