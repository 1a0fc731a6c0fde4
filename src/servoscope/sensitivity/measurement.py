"""How errors grow under a disturbance: in images taken anew, and predicted from derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.acquisition import AcquisitionConfig
from servoscope.data.splits import Split
from servoscope.errors import InvalidInputError
from servoscope.pipeline import FeatureTable, Fitted, PosePipeline, Recipe, fit_all
from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS
from servoscope.processes import in_processes, one_blas_thread
from servoscope.robots.registry import make_robot
from servoscope.scene.disturbances import Disturbance, Look
from servoscope.scene.render import render

DOUBLE = 2.0
"""How many times the clean error is said to be doubled."""

PARTED = 0.2
"""Share of the simulated error that first order is off by where the two are said to part."""


@dataclass(frozen=True)
class ErrorGrowth:
    """Error of one dof at each strength of a disturbance.

    Parameters
    ----------
    strengths : tuple of float
        Without 0.
    unit : str
        Of the strengths.
    simulated_rms, predicted_rms : tuple of float
        RMS errors: in images taken anew, and by the first-order prediction, [error_unit].
    simulated_bias : tuple of float
        Mean errors in the images taken anew, which one image at a known pose would correct,
        [error_unit].
    clean_rms : float
        RMS error undisturbed, [error_unit].
    error_unit : {"mm", "deg"}
    power : {1, 2}
        To first order the error goes with this power of the strength.

    Examples
    --------
    >>> growth = ErrorGrowth((1.0, 3.0), "px", (2.0, 4.0), (2.0, 3.0), (0.0, 0.0), 1.0, "mm")
    >>> growth.doubles_at
    1.0
    >>> round(growth.parts_at, 3)
    2.6
    """

    strengths: tuple[float, ...]
    unit: str
    simulated_rms: tuple[float, ...]
    predicted_rms: tuple[float, ...]
    simulated_bias: tuple[float, ...]
    clean_rms: float
    error_unit: str
    power: int = 1

    @property
    def doubles_at(self) -> float | None:
        """The smallest strength, of either sign, at which the error is twice the clean one.

        Between strengths the mean square error is taken to go with the square of what the error
        goes with to first order. None if it is never reached.
        """
        squares = [rms**2 for rms in self.simulated_rms]
        clean = self.clean_rms**2
        return first_reached(
            self.strengths, squares, start=clean, level=DOUBLE**2 * clean, power=2 * self.power
        )

    @property
    def parts_at(self) -> float | None:
        """The smallest strength at which first order is more than a fifth off the simulation.

        Interpolated between strengths; None if it never is.
        """
        off = [
            abs(p - s) / s if s else 0.0
            for s, p in zip(self.simulated_rms, self.predicted_rms, strict=True)
        ]
        return first_reached(self.strengths, off, start=0.0, level=PARTED)

    def to_dict(self) -> dict[str, Any]:
        """All of it, as plain JSON values."""
        plain = {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(self).items()}
        return {**plain, "doubles_at": self.doubles_at, "parts_at": self.parts_at}


def first_reached(
    strengths: Sequence[float],
    values: Sequence[float],
    *,
    start: float,
    level: float,
    power: int = 1,
) -> float | None:
    """The smallest strength without its sign at which values reach a level, interpolated.

    Between strengths, from `start` at 0, the values go with their power.

    Examples
    --------
    >>> first_reached((-2.0, -1.0, 1.0, 2.0), (4.0, 2.0, 1.0, 2.0), start=0.0, level=3.0)
    1.5
    """
    reached = []
    for sign in (-1, 1):
        side = sorted(
            (abs(s) ** power, v) for s, v in zip(strengths, values, strict=True) if s * sign > 0
        )
        before, value = 0.0, start
        for here, further in side:
            if further >= level:
                share = (level - value) / (further - value) if further > value else 0.0
                reached.append((before + max(share, 0.0) * (here - before)) ** (1 / power))
                break
            before, value = here, further
    return min(reached, default=None)


Array = NDArray[np.float64]


def predict_rms(clean_errors: Array, slopes: tuple[Array, Array], phi: Sequence[float]) -> Array:
    """RMS errors to first order, from two estimates of the errors' derivatives.

    Parameters
    ----------
    clean_errors : ndarray of shape (n_images, n_dofs)
    slopes : pair of ndarrays of shape (n_draws, n_images, n_dofs)
        Derivatives of the errors by ``phi``, each from differences of other images.
    phi : sequence of float
        How far to go along them.

    Returns
    -------
    ndarray of shape (len(phi), n_dofs)
        Over draws and images.

    Notes
    -----
    With ``e`` the clean errors and ``d``, ``d'`` the two derivatives, the mean square is
    ``<e^2> + phi <e (d + d')> + phi^2 <d d'>``. Features that count pixels change by leaps, and
    what a difference has of those is divided by a small step and would be multiplied by a large
    ``phi``. The leaps of the two differences have nothing to do with each other: in the product
    they average out, where the square of one would add them up. For smooth features
    ``d = d'``, and this is the mean square of ``e + phi d``.

    Examples
    --------
    >>> e, d = np.ones((1, 1)), np.full((1, 1, 1), 2.0)
    >>> predict_rms(e, (d, d), [-1.0, 3.0])[:, 0]
    array([1., 7.])
    """
    first, second = slopes
    square = (clean_errors**2).mean(axis=0)
    linear = (clean_errors * (first + second)).mean(axis=(0, 1))
    quadratic = np.maximum((first * second).mean(axis=(0, 1)), 0)
    strengths = np.asarray(phi, dtype=float)[:, None]
    mean_square = square + strengths * linear + strengths**2 * quadratic
    return np.asarray(np.sqrt(np.maximum(mean_square, 0)))


_STEP = 1e-4
"""Step of differences of regressors that have no gradient, in spreads of the features."""


@dataclass(frozen=True, eq=False)
class PoseModel:
    """The displacement of the camera as predicted from an image, and its derivative.

    Parameters
    ----------
    pipeline : PosePipeline
        Of all six dofs. Where a regressor has a ``gradient(X)``, of shape (n, n_features), it is
        used.
    spreads : ndarray of shape (n_features,)
        Standard deviations of the features in training.
    """

    pipeline: PosePipeline
    spreads: Array = field(repr=False)

    def transform(self, images: NDArray[Any]) -> Array:
        """Features of images, (n, n_features)."""
        return self.pipeline.compute_features(images)

    def predict(self, X: Array) -> Array:
        """Displacements predicted from features, (n, 6), [m] and [rad]."""
        return self.pipeline.predict_from(X)[0]

    def slope(self, X: Array, direction: Array) -> Array:
        """How fast `predict` changes at features X as they go along directions.

        Parameters
        ----------
        X, direction : ndarrays of shape (n, n_features)

        Returns
        -------
        ndarray of shape (n, 6)
            [m] and [rad], for each time that the direction is gone along.
        """
        slopes = [self._slope_of(one, X, direction) for one in self.pipeline.regressors_.values()]
        return np.column_stack(slopes) * self.pipeline.ranges_

    def _slope_of(self, fitted: Fitted, X: Array, direction: Array) -> Array:
        regressor, columns = fitted.regressor, fitted.columns
        X, direction, spreads = X[:, columns], direction[:, columns], self.spreads[columns]
        if hasattr(regressor, "gradient"):
            return np.asarray(np.einsum("ij,ij->i", regressor.gradient(X), direction))
        size = np.abs(direction / np.where(spreads > 0, spreads, np.inf)).max(axis=1)
        h = _STEP / np.where(size > 0, size, 1.0)
        ahead = regressor.predict(X + h[:, None] * direction)
        behind = regressor.predict(X - h[:, None] * direction)
        return np.asarray((ahead - behind) / (2 * h))


def fit_pose_model(
    images: NDArray[np.uint8], delta_p: Array, ranges: Array, recipe: Recipe
) -> PoseModel:
    """Fit a recipe for each dof to targets in shares of the range.

    The last fifth of the images stops networks.

    Parameters
    ----------
    images : ndarray of shape (n, height, width)
    delta_p : ndarray of shape (n, 6)
        [m] and [rad], in `DOFS` order.
    ranges : ndarray of shape (6,)
        [m] and [rad].
    recipe : Recipe
    """
    n, targets = len(images), delta_p / ranges
    split = Split(np.arange(n - n // 5), np.arange(n - n // 5, n), np.arange(0))
    table = FeatureTable.fit(images, targets, recipe.families, n_jobs=1)
    fitted = fit_all(table, targets, split, [(recipe, dof) for dof in DOFS], n_jobs=1)
    pipeline = PosePipeline.from_fitted(table, fitted, ranges, split, images[0])
    return PoseModel(pipeline, table.values.std(axis=0))


_STREAM = 20013
"""Keeps what disturbances draw apart from what acquisitions draw."""


def take_images(
    config: AcquisitionConfig,
    numbers: Sequence[int],
    disturbance: Disturbance | None = None,
    strength: float = 0.0,
    draw: int = 0,
) -> NDArray[np.uint8]:
    """Images of an acquisition, taken anew with everything as it was but for a disturbance.

    Parameters
    ----------
    config : AcquisitionConfig
        With the robot "free".
    numbers : sequence of int
        Which of its images.
    disturbance : Disturbance, optional
    strength : float
        In the disturbance's unit.
    draw : int
        Another number draws another random disturbance, the same one at every strength.

    Returns
    -------
    ndarray of shape (n, image_size, image_size), uint8
        Without a disturbance, the images of the acquisition, bit for bit.

    Raises
    ------
    InvalidInputError
        If the config asks for another robot, or has no such images.

    Examples
    --------
    >>> take_images(AcquisitionConfig(n_images=5, image_size=32), [1, 4]).shape
    (2, 32, 32)
    """
    if config.robot != "free":
        raise InvalidInputError(
            f"Images are taken anew with the robot free only, got {config.robot!r}."
        )
    if not len(numbers) or not all(0 <= i < config.total() for i in numbers):
        raise InvalidInputError(
            f"numbers must be of the {config.total()} images of the acquisition, got {numbers}."
        )
    poses = config.poses()
    images = []
    for i in numbers:
        look = Look(config.scene())
        if disturbance is not None:
            rng = np.random.default_rng([config.seed, _STREAM, i, draw])
            look = disturbance.change(look, strength, rng)
        images.append(_take(config, i, poses[i], look))
    return np.stack(images)


def _take(
    config: AcquisitionConfig, i: int, T_world_cam: NDArray[np.float64], look: Look
) -> NDArray[np.uint8]:
    rng = config.camera_rng(i)
    robot = make_robot("free", config.scene(), config.repeatability(), rng)
    robot.move_to(T_world_cam)
    image = render(look.scene, robot.true_pose @ look.departure, rng)
    if look.added_noise is None:
        return image
    return np.clip(np.rint(image + look.added_noise), 0, 255).astype(np.uint8)


Growths = dict[str, dict[str, ErrorGrowth]]
"""By model and dof."""

Features = dict[float, Array]
"""Of the images at each strength, 0 being undisturbed, (n_draws, n_images, n_features)."""

N_DRAWS = 2
"""Draws of a random disturbance for each image."""


def measure(
    disturbance: Disturbance,
    models: Mapping[str, PoseModel],
    config: AcquisitionConfig,
    numbers: Sequence[int],
    *,
    n_draws: int = N_DRAWS,
    n_jobs: int = -1,
    on_progress: Callable[[int], object] | None = None,
) -> Growths:
    """How the errors of trained models grow with a disturbance that they were not trained for.

    Parameters
    ----------
    disturbance : Disturbance
    models : dict of PoseModel
    config : AcquisitionConfig
        What the models were trained for.
    numbers : sequence of int
        The images of it that test.
    n_draws : int
        Draws of a random disturbance for each image.

    Returns
    -------
    dict of dicts of ErrorGrowth
        By model and dof.

    Notes
    -----
    The error is that of the displacement about the pivot, against the one that the robot reports.
    With ``p`` the prediction, ``f`` the features and ``phi`` the strength, or its square where
    the image changes with that, the error of image ``i`` is to first order ``e_i(0) +
    (dp/df)(df/dphi)_i phi``. The first derivative is the regressors' own, the second a central
    difference of images taken at a small strength to both sides (to one side of ``phi = 0``
    where it cannot be negative). A random disturbance goes another way in every image and draw,
    so that over many the mean square grows by ``phi^2`` times the sum of the squared derivatives
    by all that is drawn.
    """
    draws = range(n_draws if disturbance.is_random else 1)
    strengths = all_strengths(disturbance)
    calls: list[tuple[Any, ...]] = [(config, numbers)]
    calls += [(config, numbers, disturbance, s, k) for s in strengths for k in draws]
    rows: dict[str, list[Array]] = {name: [] for name in models}
    with one_blas_thread():
        for n_done, images in enumerate(in_processes(take_images, calls, n_jobs), start=1):
            for name, model in models.items():
                rows[name].append(model.transform(images))
            if on_progress is not None:
                on_progress(n_done)
        known = config.displacements()[list(numbers)]
        growths = {}
        for name, model in models.items():
            clean, *disturbed = rows[name]
            blocks = np.stack(disturbed).reshape(len(strengths), len(draws), *clean.shape)
            features = {0.0: clean[None], **dict(zip(strengths, blocks, strict=True))}
            growths[name] = _growths(disturbance, model, features, known)
    return growths


def n_sets(disturbance: Disturbance, n_draws: int = N_DRAWS) -> int:
    """How many sets of images `measure` takes."""
    return 1 + len(all_strengths(disturbance)) * (n_draws if disturbance.is_random else 1)


def all_strengths(disturbance: Disturbance) -> list[float]:
    """All strengths at which images are taken, those of the derivatives too."""
    behind = {-step for step in disturbance.steps} if disturbance.power == 1 else set()
    return sorted({*disturbance.strengths, *disturbance.steps, *behind})


def _growths(
    disturbance: Disturbance, model: PoseModel, features: Features, known: Array
) -> dict[str, ErrorGrowth]:
    clean_errors = _errors(model, features[0.0], known)[0]
    simulated = np.stack([_errors(model, features[s], known) for s in disturbance.strengths])
    first, second = (_slopes(disturbance, model, features, step) for step in disturbance.steps)
    return error_growths(disturbance, clean_errors, simulated, (first, second))


def error_growths(
    disturbance: Disturbance, clean_errors: Array, simulated: Array, slopes: tuple[Array, Array]
) -> dict[str, ErrorGrowth]:
    """The growth of each dof's error, from the errors in undisturbed images (n_images, 6) and at
    the strengths of a disturbance (n_strengths, n_draws, n_images, 6), [mm] and [deg], and the
    derivatives of the errors, see `predict_rms`.
    """
    phi = [s**disturbance.power for s in disturbance.strengths]
    predicted_rms = predict_rms(clean_errors, slopes, phi)
    simulated_rms = np.sqrt((simulated**2).mean(axis=(1, 2)))
    bias = simulated.mean(axis=(1, 2))
    clean_rms = np.sqrt((clean_errors**2).mean(axis=0))
    return {
        dof: ErrorGrowth(
            strengths=disturbance.strengths,
            unit=disturbance.unit,
            simulated_rms=tuple(simulated_rms[:, i].tolist()),
            predicted_rms=tuple(predicted_rms[:, i].tolist()),
            simulated_bias=tuple(bias[:, i].tolist()),
            clean_rms=float(clean_rms[i]),
            error_unit=DISPLAY_UNITS[i],
            power=disturbance.power,
        )
        for i, dof in enumerate(DOFS)
    }


def _errors(model: PoseModel, features: Array, known: Array) -> Array:
    """Predicted minus reported by the robot, (n_draws, n_images, 6), [mm] and [deg]."""
    return (np.stack([model.predict(X) for X in features]) - known) * DISPLAY_FACTORS


def _slopes(disturbance: Disturbance, model: PoseModel, features: Features, step: float) -> Array:
    """Derivatives of the errors by ``phi``, (n_draws, n_images, 6), [mm] and [deg]."""
    directions = differences(disturbance, features, step)
    clean = features[0.0][0]
    return np.stack([model.slope(clean, d) for d in directions]) * DISPLAY_FACTORS


def differences(disturbance: Disturbance, values: Mapping[float, Array], step: float) -> Array:
    """Derivatives of values by ``phi``, from those at a step of the strength and without it."""
    if disturbance.power == 1:
        return (values[step] - values[-step]) / (2 * step)
    return (values[step] - values[0.0]) / step**disturbance.power
