"""The errors that servoscope raises.

Every one of them derives from `ServoscopeError`. A message is one line that says what was wanted,
what came, and what to do.
"""

from typing import Any


class ServoscopeError(Exception):
    """Base class of every error that servoscope raises on purpose."""


class InvalidInputError(ServoscopeError, ValueError):
    """An argument or an array is not of the shape, type or range that was asked for."""


class DataSetError(ServoscopeError, ValueError):
    """A data set, or a file that one is read from, is missing, damaged or inconsistent."""


class FolderExistsError(ServoscopeError, FileExistsError):
    """A folder already holds results, and nobody said to resume or to replace them."""


class FolderInUseError(ServoscopeError):
    """A folder is being written by another command."""


class ProcessesError(ServoscopeError):
    """Processes cannot be started, or one of them was killed."""


class ProcessKilledError(ProcessesError):
    """A process, or worker after worker of a cluster, was killed in a call: in ``call``, if that is
    known.
    """

    def __init__(self, message: str, call: tuple[Any, ...] = ()) -> None:
        super().__init__(message)
        self.call = call


class RunFolderError(ServoscopeError, ValueError):
    """A run folder is unfinished, damaged, or was written by another version."""


class ModelError(ServoscopeError, ValueError):
    """A trained model is missing, damaged, not to be trusted, or of a newer version."""


class PluginError(ServoscopeError):
    """Features, a regressor, a robot, a camera or a format of others cannot be used."""


class RobotFaultError(ServoscopeError):
    """A robot cannot or will not do what it was asked to."""


class RobotStoppedError(ServoscopeError):
    """A robot was stopped or lost, and a person has to see to it before it moves again."""


class CameraFaultError(ServoscopeError):
    """A camera cannot be reached, or gives no image."""


class AcquisitionStoppedError(ServoscopeError):
    """An acquisition was stopped; what was taken is on disk, and the same command goes on."""


class ServoscopeWarning(UserWarning):
    """Something that did not stop the work but that its user should know."""
