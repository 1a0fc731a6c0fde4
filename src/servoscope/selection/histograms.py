"""Entropies of binned variables: bins, counts, and the information and bias that follow."""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import rankdata

from servoscope.arrays import as_numbers
from servoscope.compiled import compiled
from servoscope.errors import InvalidInputError
from servoscope.selection.samples import as_table, check_span

MAX_BINS = 256
"""More bins than a byte can number are of no use: the bias of the information, about
``(n_bins - 1)^2 / (2 n_samples ln 2)`` bits, would swamp it for any sensible number of samples."""

Codes = NDArray[np.uint8]


def bin_codes(X: ArrayLike, n_bins: int = 10, name: str = "X") -> Codes:
    """Number of the bin that every value falls in, one row a column of `X`.

    Each column's range is cut into `n_bins` of equal width. A value on an edge belongs to the
    bin on its right, the maximum to the last bin: the rule of `numpy.histogram`. All values of a
    constant column fall in bin 0.

    Parameters
    ----------
    X : array of shape (n_samples, n_columns)
    n_bins : int
        2 to 256.
    name : str
        What error messages call `X`.

    Returns
    -------
    ndarray of shape (n_columns, n_samples), uint8
        A row is contiguous, so that two of them can be counted against each other quickly.

    Raises
    ------
    InvalidInputError
        If `X` is not a table of finite numbers, has no sample, or `n_bins` is out of range.

    Examples
    --------
    >>> bin_codes([[0.0], [0.5], [1.9], [2.0]], n_bins=4)
    array([[0, 1, 3, 3]], dtype=uint8)
    """
    check_n_bins(n_bins)
    values = as_table(X, name)
    low, high = values.min(axis=0), values.max(axis=0)
    check_span(low, high, name)
    return _codes(values, low, high, n_bins)


def check_n_bins(n_bins: int) -> None:
    """Raise InvalidInputError unless `n_bins` is an integer from 2 to `MAX_BINS`."""
    if not isinstance(n_bins, int | np.integer) or not 2 <= n_bins <= MAX_BINS:
        raise InvalidInputError(f"n_bins must be an integer from 2 to {MAX_BINS}, got {n_bins!r}.")


@compiled()
def _codes(
    X: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64], n_bins: int
) -> Codes:
    n_samples, n_columns = X.shape
    edges = np.empty((n_columns, n_bins + 1))
    for j in range(n_columns):
        edges[j] = np.linspace(low[j], high[j], n_bins + 1)
    codes = np.zeros((n_columns, n_samples), np.uint8)
    for i in range(n_samples):
        for j in range(n_columns):
            if high[j] > low[j]:
                x = X[i, j]
                code = min(int((x - low[j]) / (high[j] - low[j]) * n_bins), n_bins - 1)
                # Rounding may have put a value that is next to an edge on its wrong side.
                while code > 0 and x < edges[j, code]:
                    code -= 1
                while code < n_bins - 1 and x >= edges[j, code + 1]:
                    code += 1
                codes[j, i] = code
    return codes


def quantile_codes(X: NDArray[np.float64], n_bins: int = 10) -> Codes:
    """Number of the bin of equal frequency that every value falls in, one row a column of `X`,
    uint8. Equal values fall in the same bin, so that bins of a column with ties differ in number.

    Examples
    --------
    >>> quantile_codes(np.array([[1.0], [2.0], [4.0], [800.0]]), n_bins=2)
    array([[0, 0, 1, 1]], dtype=uint8)
    """
    check_n_bins(n_bins)
    share = (rankdata(X, axis=0) - 0.5) / len(X)
    return np.ascontiguousarray((share * n_bins).astype(np.uint8).T)


def entropy_of_values(table: NDArray) -> NDArray[np.float64]:
    """Entropy of each column's distinct values, from their relative frequencies, [bits].

    No information about a discrete variable is larger. It is infinite where no two values are
    equal: such a variable counts as continuous.

    Examples
    --------
    >>> entropy_of_values(np.array([[0, 1], [0, 2], [1, 3], [1, 4]]))
    array([ 1., inf])
    """
    return np.array([_entropy(np.unique(column, return_counts=True)[1]) for column in table.T])


def at_most_entropy(
    information: NDArray[np.float64], X: NDArray, Y: NDArray
) -> NDArray[np.float64]:
    """Information of every column of X about every one of Y, at most the entropy of either."""
    limit = np.minimum.outer(entropy_of_values(X), entropy_of_values(Y))
    return np.minimum(information, limit)


def _entropy(counts: NDArray[np.intp]) -> float:
    n = counts.sum()
    # In this order the entropy of a constant is exactly 0.
    return float(counts @ (np.log2(n) - np.log2(counts)) / n) if len(counts) < n else np.inf


_TABLE_LENGTH = 4096
"""Counts up to this one find their n log n in a table that stays in the cache."""


def n_log_n_table(n_samples: int) -> NDArray[np.float64]:
    """The numbers n log2 n of every count that is likely among `n_samples`."""
    n = np.arange(1, min(n_samples, _TABLE_LENGTH) + 1)
    return np.concatenate([[0.0], n * np.log2(n)])


@compiled()
def n_log_n(n: int, table: NDArray[np.float64]) -> float:
    """One number n log2 n, from the table where it reaches so far."""
    return table[n] if n < len(table) else n * np.log2(n)


@compiled()
def _of_counts(counts: NDArray[np.int32], table: NDArray[np.float64]) -> tuple[float, int]:
    """Information of a joint histogram times its samples, [bits], and its excess of cells."""
    columns = np.zeros(counts.shape[1], np.int64)
    n, excess, joint, of_rows, of_columns = 0, 1, 0.0, 0.0, 0.0
    for i in range(len(counts)):
        row = int(counts[i].sum())
        n += row
        columns += counts[i]
        for count in counts[i]:
            excess += int(count > 0)
            joint += n_log_n(count, table)
        excess -= int(row > 0)
        of_rows += n_log_n(row, table)
    for column in columns:
        excess -= int(column > 0)
        of_columns += n_log_n(column, table)
    # In this order the terms cancel to exactly 0 when one of the variables is constant.
    return (joint - of_columns) + (n_log_n(n, table) - of_rows), excess


def information_of_codes(
    a: Codes, b: Codes, n_bins: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Information of every variable of `a` about every one of `b`, and its bias, [bits].

    The one is from relative frequencies, at least 0 and symmetric if `b` is `a` itself; the other
    is Miller-Madow's estimate of how much of that is chance.
    """
    n_samples = a.shape[1]
    sums, excess = _information(a, b, n_bins, n_log_n_table(n_samples), b is a)
    return np.maximum(sums / n_samples, 0.0), excess / (2 * n_samples * np.log(2))


@compiled()
def _information(
    a: Codes, b: Codes, n_bins: int, table: NDArray[np.float64], is_symmetric: bool
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    sums, excess = np.empty((len(a), len(b))), np.empty((len(a), len(b)), np.int64)
    counts = np.empty((n_bins, n_bins), np.int32)
    for i in range(len(a)):
        for j in range(i + 1 if is_symmetric else len(b)):
            counts[:] = 0
            for k in range(a.shape[1]):
                counts[a[i, k], b[j, k]] += 1
            sums[i, j], excess[i, j] = _of_counts(counts, table)
            if is_symmetric:
                sums[j, i], excess[j, i] = sums[i, j], excess[i, j]
    return sums, excess


@compiled()
def _count(a: Codes, b: Codes, counts: NDArray[np.int64]) -> None:
    for i in range(len(a)):
        for j in range(len(b)):
            for k in range(a.shape[1]):
                counts[i, j, a[i, k], b[j, k]] += 1


@compiled()
def _information_of_counts(
    counts: NDArray[np.int64], table: NDArray[np.float64]
) -> NDArray[np.float64]:
    sums = np.empty(counts.shape[:2])
    for i in range(len(sums)):
        for j in range(len(sums[0])):
            sums[i, j] = _of_counts(counts[i, j], table)[0]
    return sums


class JointCounts:
    """Counts of the bins that features and targets fall in together, block by block.

    Counts of blocks are merged in any order, with the same result.

    Parameters
    ----------
    X_range, y_range : tuples (low, high) of ndarray
        Of every feature and every target over all blocks: their bins are of equal width.
    n_bins : int

    Examples
    --------
    >>> X, y = np.arange(100.0)[:, None], np.arange(100.0)[:, None] ** 2
    >>> counts = [JointCounts((X[0], X[-1]), (y[0], y[-1]), n_bins=4) for _ in range(2)]
    >>> first, second = counts[0].update(X[:30], y[:30]), counts[1].update(X[30:], y[30:])
    >>> first.merge(second).finalize().round(3)
    array([[1.375]])
    """

    def __init__(
        self,
        X_range: tuple[ArrayLike, ArrayLike],
        y_range: tuple[ArrayLike, ArrayLike],
        n_bins: int = 10,
    ) -> None:
        check_n_bins(n_bins)
        self.n_bins = n_bins
        self._ranges = [
            tuple(as_numbers(end, "The ends of a range") for end in ends)
            for ends in (X_range, y_range)
        ]
        for (low, high), name in zip(self._ranges, ("X", "y"), strict=True):
            if not (low.ndim == 1 and low.size and low.shape == high.shape and (low <= high).all()):
                raise InvalidInputError(
                    f"The range of {name} must be its least and greatest values, one of each a "
                    f"column, got {low.tolist()} and {high.tolist()}."
                )
            check_span(low, high, name)
        n_features, n_targets = (len(low) for low, _ in self._ranges)
        self._counts = np.zeros((n_features, n_targets, n_bins, n_bins), np.int64)

    def update(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Count a block: features (n, n_features) and targets (n, n_targets), or (n,).

        Raises
        ------
        InvalidInputError
            If they are no tables of finite numbers, or beyond the ranges.
        """
        codes = []
        for table, name, (low, high) in zip((X, y), ("X", "y"), self._ranges, strict=True):
            values = as_numbers(table, name)
            if name == "y" and values.ndim == 1:
                values = values[:, None]
            if values.ndim != 2 or values.shape[1] != len(low):
                raise InvalidInputError(
                    f"{name} must be a table of {len(low)} columns, got the shape {values.shape}."
                )
            if not ((values >= low) & (values <= high)).all():
                raise InvalidInputError(
                    f"{name} must be within the ranges that were given, got values from "
                    f"{values.min():g} to {values.max():g}."
                )
            codes.append(_codes(values, low, high, self.n_bins))
        if codes[0].shape[1] != codes[1].shape[1]:
            raise InvalidInputError(
                f"X and y must have as many rows, got {codes[0].shape[1]} and {codes[1].shape[1]}."
            )
        _count(*codes, self._counts)
        return self

    def merge(self, other: JointCounts) -> Self:
        """Add the counts of other samples, with the same ranges and bins.

        Raises
        ------
        InvalidInputError
            If they have others.
        """
        alike = self.n_bins == other.n_bins and all(
            np.array_equal(own, of_other)
            for ends, of_others in zip(self._ranges, other._ranges, strict=True)
            for own, of_other in zip(ends, of_others, strict=True)
        )
        if not alike:
            raise InvalidInputError(
                "Counts are merged if their ranges and bins are the same; give both the range of "
                "all samples."
            )
        self._counts += other._counts
        return self

    def finalize(self) -> NDArray[np.float64]:
        """Mutual information of every feature with every target, (n_features, n_targets), [bits].

        It is that of `servoscope.mutual_information` of all samples.
        """
        n_samples = int(self._counts[0, 0].sum())
        if not n_samples:
            raise InvalidInputError("Information needs samples, and none was counted.")
        sums = _information_of_counts(self._counts, n_log_n_table(n_samples))
        return np.maximum(sums / n_samples, 0.0)


def conditional_information(
    features: Codes, target: Codes, condition: NDArray[np.integer], n_bins: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Information of every feature about the target given the condition, and its bias, [bits].

    The one is ``I(f; y | z)`` from relative frequencies, at least 0; the other is Miller-Madow's
    estimate of how much of that is chance. There are as many cells as conditions times bins times
    bins, and few samples for each: it may be most of it.
    """
    order = np.argsort(condition, kind="stable")
    changes = np.flatnonzero(np.diff(condition[order])) + 1
    groups = np.stack([np.append(0, changes), np.append(changes, len(order))], axis=1)
    n_samples = len(order)
    sums, excess = _conditional(features, target, order, groups, n_bins, n_log_n_table(n_samples))
    return np.maximum(sums / n_samples, 0.0), excess / (2 * n_samples * np.log(2))


@compiled()
def _conditional(
    features: Codes,
    target: Codes,
    order: NDArray[np.intp],
    groups: NDArray[np.intp],
    n_bins: int,
    table: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    sums, excess = np.zeros(len(features)), np.zeros(len(features), np.int64)
    counts = np.empty((n_bins, n_bins), np.int32)
    for i in range(len(features)):
        for start, end in groups:
            counts[:] = 0
            for k in order[start:end]:
                counts[features[i, k], target[k]] += 1
            total, cells = _of_counts(counts, table)
            sums[i] += total
            excess[i] += cells
    return sums, excess


_NEGLIGIBLE = 1e-17
"""Counts that are less likely than this, as a share of the likeliest, are left out."""


def expected_information(a: Codes, b: Codes, n_bins: int) -> NDArray[np.float64]:
    """Mean mutual information of every two variables over all orders of their samples, [bits].

    Notes
    -----
    With the histograms of both variables kept, the count of a cell is hypergeometric: of the
    ``n_i`` samples in a bin of one variable, each is among the ``m_j`` in a bin of the other.

    References
    ----------
    N. Vinh, J. Epps and J. Bailey, "Information theoretic measures for clusterings comparison",
    Journal of Machine Learning Research 11, 2010.
    """
    counts_a, counts_b = (
        np.stack([np.bincount(row, minlength=n_bins) for row in c]) for c in (a, b)
    )
    return _expected(counts_a, counts_b, a.shape[1], n_log_n_table(a.shape[1]))


@compiled()
def _expected(
    counts_a: NDArray[np.int64],
    counts_b: NDArray[np.int64],
    n_samples: int,
    table: NDArray[np.float64],
) -> NDArray[np.float64]:
    of_a, of_b = _sums_n_log_n(counts_a, table), _sums_n_log_n(counts_b, table)
    information = np.empty((len(counts_a), len(counts_b)))
    for i in range(len(counts_a)):
        for j in range(len(counts_b)):
            joint = 0.0
            for n in counts_a[i]:
                for m in counts_b[j]:
                    joint += _expected_n_log_n(n, m, n_samples, table)
            # In this order the terms cancel to exactly 0 when one of the variables is constant.
            total = (joint - of_b[j]) + (n_log_n(n_samples, table) - of_a[i])
            information[i, j] = max(total / n_samples, 0.0)
    return information


@compiled()
def _sums_n_log_n(counts: NDArray[np.int64], table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum of n log2 n over each row of counts."""
    sums = np.zeros(len(counts))
    for i in range(len(counts)):
        for n in counts[i]:
            sums[i] += n_log_n(n, table)
    return sums


@compiled()
def _expected_n_log_n(n: int, m: int, n_samples: int, table: NDArray[np.float64]) -> float:
    """Mean of k log2 k, k being how many of n samples are among m of all."""
    mode = (n + 1) * (m + 1) // (n_samples + 2)
    weights, total = 1.0, n_log_n(mode, table)
    weight, k = 1.0, mode
    while weight > _NEGLIGIBLE and k < min(n, m):
        weight *= (n - k) * (m - k) / ((k + 1) * (n_samples - n - m + k + 1))
        k += 1
        weights += weight
        total += weight * n_log_n(k, table)
    weight, k = 1.0, mode
    while weight > _NEGLIGIBLE and k > max(0, n + m - n_samples):
        weight *= k * (n_samples - n - m + k) / ((n - k + 1) * (m - k + 1))
        k -= 1
        weights += weight
        total += weight * n_log_n(k, table)
    return total / weights
