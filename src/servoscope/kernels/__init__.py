"""Gaussian processes of smooth functions of the features, in closed form."""

from servoscope.kernels.gaussian import (
    GaussianKernel,
    KernelPosterior,
    fit_kernel,
    inverse_covariance,
    leave_out_residuals,
    shots_left_out,
)
from servoscope.kernels.repeats import find_repeats, merge_repeats, whole_poses

__all__ = [
    "GaussianKernel",
    "KernelPosterior",
    "find_repeats",
    "fit_kernel",
    "inverse_covariance",
    "leave_out_residuals",
    "merge_repeats",
    "shots_left_out",
    "whole_poses",
]
