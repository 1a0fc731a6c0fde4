"""The regressors by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import ArrayLike
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

    Raises
    ------
    InvalidInputError
        If there is no regressor of that name.

    Examples
    --------
    >>> make_regressor("kernel_ridge")
    GaussianKernelRidge()
    """
    return _class_of(regressor)() if isinstance(regressor, str) else clone(regressor)


def regressor_as_arrays(regressor: Any) -> dict[str, Any]:
    """A fitted regressor as plain arrays, with its name among them.

    Raises
    ------
    InvalidInputError
        If it is not one of `REGRESSORS`.
    """
    for name, kind in REGRESSORS.built_in.items():
        if type(regressor) is kind:
            return {"regressor": name, **regressor.to_arrays()}
    raise InvalidInputError(
        f"A regressor that is kept as arrays must be one of {', '.join(REGRESSORS)}, "
        f"got {type(regressor).__name__}."
    )


def regressor_from_arrays(arrays: Mapping[str, ArrayLike]) -> Any:
    """The regressor that `regressor_as_arrays` was called on.

    Arrays without a name are of the paper's, from when there was no other.

    Raises
    ------
    InvalidInputError
        If there is no regressor of that name, or arrays are missing or do not belong together.
    """
    return _class_of(str(arrays.get("regressor", "levenberg_marquardt"))).from_arrays(arrays)


def _class_of(name: str) -> Any:
    if name not in REGRESSORS:
        raise InvalidInputError(
            f"There is no regressor named {name!r}; there are {', '.join(REGRESSORS)}."
        )
    return REGRESSORS[name]
