"""Bringing the camera to the reference: look, believe where it is, move back, look again."""

from __future__ import annotations

from os import PathLike

from servoscope.errors import InvalidInputError
from servoscope.positioning import guard
from servoscope.positioning.interfaces import Camera, Estimator, Robot, dofs_of
from servoscope.positioning.model import PositioningModel
from servoscope.positioning.reference_view import ReferenceView
from servoscope.positioning.result import PositioningResult
from servoscope.positioning.run import OnStep, Run
from servoscope.positioning.settings import LoopSettings
from servoscope.processes import one_blas_thread


class Positioner:
    """Brings a camera back to the view of a reference image.

    Parameters
    ----------
    estimator : Estimator
    settings : LoopSettings, optional

    Raises
    ------
    InvalidInputError
        If the estimator's reference image does not fit its image shape, or shows nothing, or if a
        tolerance is of a dof that the estimator is not for.

    Examples
    --------
    A cell that is camera, robot and estimator in one:

    >>> import numpy as np
    >>> from servoscope.poses import rigid_transform
    >>> from servoscope.positioning import Estimate
    >>> class Cell:
    ...     image_shape, pivot, reach = (8, 8), 0.5, np.full(6, 0.1)
    ...     reference_image = np.arange(64, dtype=np.uint8).reshape(8, 8)
    ...     pose = rigid_transform(np.eye(3), [0.02, 0.0, 0.0])
    ...
    ...     def read(self):
    ...         return self.reference_image + np.uint8(1e3 * self.pose[0, 3])
    ...
    ...     def move(self, displacement):
    ...         self.pose = self.pose @ displacement
    ...         return displacement
    ...
    ...     def estimate(self, image, previous):
    ...         return Estimate(self.pose, np.full(6, np.nan), np.nan, "exact")
    >>> cell = Cell()
    >>> Positioner(cell).run(cell, cell).message
    'Converged after 1 move, believed 0.00 mm and 0.000 deg away.'
    """

    def __init__(self, estimator: Estimator, settings: LoopSettings | None = None) -> None:
        self.estimator = estimator
        self.settings = LoopSettings() if settings is None else settings
        reference = estimator.reference_image
        if reason := guard.image_format_fault(reference, estimator.image_shape):
            raise InvalidInputError(f"The reference image does not fit. {reason}")
        ReferenceView(reference)
        dofs = dofs_of(estimator)
        if others := [dof for dof in self.settings.tolerances if dof not in dofs]:
            raise InvalidInputError(
                f"tolerances must be of dofs that the model commands, {', '.join(dofs)}, got "
                f"{', '.join(others)}; leave it out."
            )

    @classmethod
    def load(cls, folder: str | PathLike[str], settings: LoopSettings | None = None) -> Positioner:
        """A positioner with a model that ``servoscope train`` has written.

        Raises
        ------
        ModelError
            If the model is missing, damaged, or of a newer version.
        """
        return cls(PositioningModel.load(folder), settings)

    def run(
        self,
        robot: Robot,
        camera: Camera,
        *,
        dry_run: bool = False,
        on_step: OnStep | None = None,
    ) -> PositioningResult:
        """Look and move until the camera is at the reference, or a reason not to go on.

        A robot that offers ``stop()`` is stopped at the end, however the run ended; only a dry
        run, in which nothing was commanded, leaves it alone. After `diverged` and `max_moves` the
        robot first drives back the way it came to the best view seen, if that was better.

        Parameters
        ----------
        robot : Robot
        camera : Camera
        dry_run : bool
            Look once and say what the move would be, without making it.
        on_step : callable, optional
            Called with each `Step` and its image before the robot moves, ``executed`` not yet
            known.

        Returns
        -------
        PositioningResult
            Faults of the camera, the robot, the estimator or `on_step`, Ctrl-C and SIGTERM are
            reported in it, never raised.

        Notes
        -----
        BLAS is kept to one thread meanwhile: a run is the same on any number of cores.
        """
        with one_blas_thread():
            return Run(self.estimator, self.settings, robot, camera, on_step).until_end(dry_run)
