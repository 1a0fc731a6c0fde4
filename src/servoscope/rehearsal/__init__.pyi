from .run import Rehearsal as Rehearsal
from .true_view import OwnErrors as OwnErrors
from .true_view import TrueView as TrueView
