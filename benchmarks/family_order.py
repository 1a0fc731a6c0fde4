"""Why the order of the families is not the published one: how the nets start and are damped.

Not timed: ``python -m benchmarks.family_order DATASET`` prints the mean RMS test error of GM, PCA
and PCI under the paper's protocol, pivot form, for several ways to train the same nets.
"""

from __future__ import annotations

import sys

import numpy as np

import servoscope as sv
from servoscope.data.splits import split_images
from servoscope.regression.levenberg_marquardt import LMSettings, levenberg_marquardt
from servoscope.regression.tanh_network import append_ones, evaluate, initial_weights

HIDDEN, TRIALS = 30, 3


def unit_variance_start(n_features: int, hidden: int, rng: np.random.Generator) -> np.ndarray:
    """Weights under which the sum that enters a unit has unit variance."""
    weights = initial_weights(n_features, hidden, rng)
    hidden_weights = weights[: hidden * (n_features + 1)].reshape(hidden, n_features + 1)
    hidden_weights[:, :-1] *= np.sqrt(n_features)
    return weights


WAYS = {
    "servoscope: small starts, damping 10": (initial_weights, LMSettings(damping=10.0)),
    "unit-variance starts, damping 10": (unit_variance_start, LMSettings(damping=10.0)),
    "unit-variance starts, damping 0.001": (unit_variance_start, LMSettings(damping=1e-3)),
}


def main(folder: str) -> None:
    """Print one line a way of training."""
    data = sv.PoseImageSet.load(folder)
    targets = data.delta_p() / data.ranges()
    split = split_images(len(data), "paper")
    train, test = split.train, split.test
    families = {
        "GM": sv.GeometricMoments(),
        "PCA": sv.Eigenfeatures(24),
        "PCI": sv.PoseImageCovariance(),
    }
    features = {
        name: family.fit(data.images[train], targets[train]).transform(data.images)
        for name, family in families.items()
    }
    print(f"{'':40}" + "".join(f"{name:>8}" for name in features))
    for way, (start, settings) in WAYS.items():
        errors = []
        for X in features.values():
            X = (X - X[train].mean(axis=0)) / X[train].std(axis=0)
            errors.append(
                np.mean([_best_error(X, y, train, test, start, settings) for y in targets.T])
            )
        print(f"{way:40}" + "".join(f"{error:8.3f}" for error in errors), flush=True)


def _best_error(X, y, train, test, start, settings) -> float:
    """Least RMS error on the test samples, in units of the range, of some trials."""
    mean, deviation = y[train].mean(), y[train].std()
    z = (y - mean) / deviation
    errors = []
    for trial in range(TRIALS):
        weights = start(X.shape[1], HIDDEN, np.random.default_rng(trial))
        found = levenberg_marquardt(X[train], z[train], weights, X[test], z[test], settings)
        residuals = evaluate(found.weights, append_ones(X[test])) - z[test]
        errors.append(deviation * np.sqrt(np.mean(residuals**2)))
    return min(errors)


if __name__ == "__main__":
    main(sys.argv[1])
