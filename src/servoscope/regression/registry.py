"""The regressors by name."""

from __future__ import annotations

from typing import Any

from sklearn.base import clone

from servoscope.errors import InvalidInputError
from servoscope.plugins import Registry
from servoscope.regression.kernel_regressors import GaussianKernelRidge, GaussianProcess
from servoscope.regression.network_regressors import (
    BayesianLMRegressor,
    LBFGSRegressor,
    LMRegressor,
)


def _checked(name: str, regressor: Any) -> Any:
    if not (callable(regressor) and hasattr(regressor, "fit") and hasattr(regressor, "predict")):
        raise InvalidInputError(
            f"the regressor {name!r} must be a class with fit and predict, got "
            f"{repr(regressor)[:80]}"
        )
    return regressor


REGRESSORS: Registry[Any] = Registry(
    "servoscope.regressors",
    {
        "gaussian_process": GaussianProcess,
        "kernel_ridge": GaussianKernelRidge,
        "levenberg_marquardt": LMRegressor,
        "bayesian_lm": BayesianLMRegressor,
        "lbfgs": LBFGSRegressor,
    },
    _checked,
)
"""Called without arguments they make a regressor of that name; ``"levenberg_marquardt"`` is the
paper's. Further ones are added by entry points ``servoscope.regressors``."""


def make_regressor(regressor: Any) -> Any:
    """A new regressor of that name, or an unfitted copy of that estimator.

    Examples
    --------
    >>> make_regressor("kernel_ridge")
    GaussianKernelRidge()
    """
    if not isinstance(regressor, str):
        return clone(regressor)
    if regressor not in REGRESSORS:
        raise InvalidInputError(
            f"There is no regressor named {regressor!r}; there are {', '.join(REGRESSORS)}."
        )
    return REGRESSORS[regressor]()
