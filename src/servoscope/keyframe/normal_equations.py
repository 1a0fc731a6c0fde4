"""Normal equations of all unknowns, image by image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.keyframe.state import N_GLOBAL, N_LOCAL
from servoscope.keyframe.warping import UNSEEN

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

BEND = 2.5
"""Residuals of this many standard deviations count a quarter."""

LEAST_SCALE = 0.7
"""Residuals are never taken to spread less than this, [grey]."""

LEAST_SEEN = 0.1
"""An image that sees a smaller share of the points is left out, at the cost `WORST_COST`."""

WORST_COST = 30.0


@dataclass(eq=False)
class NormalEquations:
    """Normal equations of all unknowns, and of each pixel's inverse depth."""

    hessian: Array
    gradient: Array
    coupling: Floats | None
    depth: Floats
    depth_hessian: Floats
    depth_gradient: Floats
    weight_sum: Floats
    n_seen: Floats
    scales: Array
    costs: Array

    @classmethod
    def empty(cls, n_images: int, depth: Floats, relief: bool) -> NormalEquations:
        n = N_GLOBAL + N_LOCAL * n_images
        return cls(
            np.zeros((n, n)),
            np.zeros(n),
            np.zeros((len(depth), n), np.float32) if relief else None,
            depth,
            np.zeros_like(depth),
            np.zeros_like(depth),
            np.zeros_like(depth),
            np.zeros_like(depth),
            np.full(n_images, WORST_COST),
            np.full(n_images, WORST_COST),
        )

    @property
    def cost(self) -> float:
        return float(self.costs.mean())

    def add(
        self,
        i: int,
        jacobian: Floats,
        by_depth: Floats,
        residuals: Floats,
        chain: Array,
        redundancy: float,
    ) -> None:
        """Add what image i contributes."""
        seen = residuals > UNSEEN
        n_seen = np.count_nonzero(seen)
        if n_seen < LEAST_SEEN * len(seen):
            return
        scale = max(LEAST_SCALE, 1.4826 * float(np.median(np.abs(residuals[seen]))))
        ratio2 = (residuals / np.float32(BEND * scale)) ** 2
        weights = np.where(seen, 1 / (1 + ratio2) ** 2, np.float32(0))
        self.scales[i] = scale
        self.costs[i] = BEND * scale * np.sqrt((ratio2 / (1 + ratio2))[seen].mean())
        self.weight_sum += weights
        self.n_seen += seen
        weights /= np.float32(scale * scale * redundancy)
        own = slice(N_GLOBAL + N_LOCAL * i, N_GLOBAL + N_LOCAL * (i + 1))
        weighted = jacobian * weights[:, None]
        H = (weighted.T @ jacobian).astype(float)
        g = -(weighted.T @ residuals).astype(float)
        self.hessian[:N_GLOBAL, :N_GLOBAL] += chain.T @ H @ chain
        self.hessian[:N_GLOBAL, own] = chain.T @ H[:, :N_LOCAL]
        self.hessian[own, :N_GLOBAL] = self.hessian[:N_GLOBAL, own].T
        self.hessian[own, own] = H[:N_LOCAL, :N_LOCAL]
        self.gradient[:N_GLOBAL] += chain.T @ g
        self.gradient[own] = g[:N_LOCAL]
        if self.coupling is not None:
            mixed = weighted * by_depth[:, None]
            self.coupling[:, :N_GLOBAL] += mixed @ chain.astype(np.float32)
            self.coupling[:, own] = mixed[:, :N_LOCAL]
            self.depth_hessian += weights * by_depth * by_depth
            self.depth_gradient -= weights * by_depth * residuals
