"""What a sensitivity analysis is made of."""

from __future__ import annotations

from dataclasses import dataclass

from servoscope.acquisition_config import AcquisitionConfig
from servoscope.errors import InvalidInputError
from servoscope.pipeline import Recipe
from servoscope.regression import REGRESSORS
from servoscope.sensitivity.disturbances import DISTURBANCES

FEATURES = {
    "moments": Recipe("moments"),
    "eigenfeatures": Recipe("eigenfeatures", ("e_[01]?", "e_2[0-3]")),
    "tchebichef": Recipe("tchebichef"),
    "intensity": Recipe("intensity"),
    "robust": Recipe("robust"),
}
"""What a model may take, by name."""

DEFAULT_FEATURES = ("moments", "eigenfeatures", "tchebichef")
"""Two of the paper's families, and a smooth one."""


@dataclass(frozen=True)
class SensitivityConfig:
    """How many images train and test, and what is disturbed.

    Parameters
    ----------
    n_images : int
        Images that train.
    n_test : int
        Poses at which images are taken anew with everything disturbed in turn.
    image_size : int
        Height and width, [px].
    seed : int
        Of poses, noise and disturbances.
    part : {"cylinder_head", "textured_plane"}
    features : tuple of str
        Names of `FEATURES`; each has a model of its own, given the same images.
    disturbances : tuple of str
        Names of `DISTURBANCES`.
    regressor : str
        Of `REGRESSORS`; ``"levenberg_marquardt"`` for the paper's nets.

    Raises
    ------
    InvalidInputError
        If there are fewer than 50 images that train or 2 that test, no features or disturbances,
        or nothing is of such a name.

    Examples
    --------
    >>> SensitivityConfig(n_images=100, n_test=3).test_numbers
    range(100, 103)
    """

    n_images: int = 400
    n_test: int = 60
    image_size: int = 128
    seed: int = 0
    part: str = "cylinder_head"
    features: tuple[str, ...] = DEFAULT_FEATURES
    disturbances: tuple[str, ...] = tuple(DISTURBANCES)
    regressor: str = "gaussian_process"

    def __post_init__(self) -> None:
        for name, least in (("n_images", 50), ("n_test", 2)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise InvalidInputError(
                    f"{name} must be a whole number from {least}, got {value!r}."
                )
        for name, known in (("features", FEATURES), ("disturbances", DISTURBANCES)):
            wanted = getattr(self, name)
            if not wanted or set(wanted) - set(known):
                raise InvalidInputError(
                    f"{name} must be taken from {', '.join(known)}, got {wanted}."
                )
        if self.regressor not in REGRESSORS:
            raise InvalidInputError(
                f"regressor must be one of {', '.join(REGRESSORS)}, got {self.regressor!r}."
            )
        self.acquisition()

    def acquisition(self) -> AcquisitionConfig:
        """The images that train, then those that test."""
        return AcquisitionConfig(
            n_images=self.n_images + self.n_test,
            image_size=self.image_size,
            seed=self.seed,
            part=self.part,
        )

    @property
    def test_numbers(self) -> range:
        """Which images of the acquisition test: the last."""
        return range(self.n_images, self.n_images + self.n_test)
