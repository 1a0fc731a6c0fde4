"""The command line."""

from __future__ import annotations

import io
import logging
import os
import re
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from errno import ENOSPC
from functools import partial, wraps
from typing import Any

from tyro.conf import FlagCreatePairsOff
from tyro.extras import SubcommandApp

from servoscope import __version__
from servoscope.commands.output import discard_unwritten, prepare_streams, print_message
from servoscope.errors import ServoscopeError
from servoscope.processes import stop_processes
from servoscope.storage.folders import remove_abandoned
from servoscope.wording import one_line, printable

DESCRIPTION = """Vision-based robot positioning: which image features inform which degree of
freedom, and how accurately. Begin with: servoscope study. Every command also takes --debug, which
shows where an error came from; --version prints the version."""

_LONGEST_MESSAGE = 2000
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process by default. It then ends, and once interrupted hears no further
        Ctrl-C; with arguments given, Ctrl-C is heard afterwards as it was before.

    Returns
    -------
    int
        0 done, 1 failed with one line on standard error, 130 interrupted. Wrong usage exits
        with 2.
    """
    is_whole_process = arguments is None
    if is_whole_process:
        prepare_streams()
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    warnings.showwarning = _print_warning
    warnings.filterwarnings("ignore", message=r"\d+ tasks (which|have)")
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # it prints names of files as they are
    try:
        _run(arguments or ["--help"])
        sys.stdout.flush()
    except KeyboardInterrupt:
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second would disturb the end
        stop_processes()
        code = _fail("interrupted; what is finished is kept", 130)
        if not is_whole_process:
            signal.signal(signal.SIGINT, before)
        return code
    except BrokenPipeError:
        discard_unwritten()
        return 1
    except Exception as error:
        if debug:
            print(printable(traceback.format_exc()), end="", file=sys.stderr)
        code = _fail(_reason(error), 1)
        discard_unwritten()
        return code
    return 0


def _run(arguments: Sequence[str]) -> None:
    if list(arguments) == ["--version"]:
        print(f"servoscope {__version__}")
        return
    remove_abandoned()
    _asked_for(arguments)()


def _asked_for(arguments: Sequence[str]) -> Callable[[], None]:
    """The command that arguments name, with its own; exits where they name none."""
    errors = io.StringIO()
    try:
        with redirect_stderr(errors):
            command: Callable[[], None] = _app().cli(
                prog="servoscope",
                description=DESCRIPTION,
                args=arguments,
                config=(FlagCreatePairsOff,),
            )
            return command
    finally:
        if errors.getvalue():
            print(printable(_COLOURS.sub("", errors.getvalue())), end="", file=sys.stderr)


def _later(command: Callable[..., None]) -> Callable[..., Callable[[], None]]:
    """What takes the arguments of a command and returns the command with them."""

    @wraps(command)
    def asked_for(*arguments: Any, **options: Any) -> Callable[[], None]:
        return partial(command, *arguments, **options)

    return asked_for


def _app() -> SubcommandApp:
    from servoscope.commands.acquire import acquire
    from servoscope.commands.aim import aim
    from servoscope.commands.assess import assess
    from servoscope.commands.benchmark_positioning import benchmark_positioning
    from servoscope.commands.export import export
    from servoscope.commands.import_images import import_commands
    from servoscope.commands.info import info
    from servoscope.commands.position import position
    from servoscope.commands.rehearse import rehearse
    from servoscope.commands.sensitivity import sensitivity
    from servoscope.commands.serve import serve
    from servoscope.commands.study import report, study
    from servoscope.commands.train import train
    from servoscope.commands.view import view

    app, formats, benchmarks = SubcommandApp(), SubcommandApp(), SubcommandApp()
    for name, import_format in import_commands().items():
        formats.command(name=name)(_later(import_format))
    app.command(_later(study))
    app.command(_later(acquire))
    app.command(_later(assess))
    app.command(formats, name="import", help="Make a data set of your own images and poses.")
    app.command(_later(train))
    app.command(_later(rehearse))
    app.command(_later(position))
    app.command(_later(view))
    app.command(_later(aim))
    app.command(_later(export))
    app.command(_later(serve))
    benchmarks.command(name="positioning")(_later(benchmark_positioning))
    app.command(benchmarks, name="benchmark", help="Compare servoscope with what else there is.")
    app.command(_later(sensitivity))
    app.command(_later(report))
    app.command(_later(info))
    return app


def _reason(error: Exception) -> str:
    """Why a command failed, on one line."""
    message = one_line(error, _LONGEST_MESSAGE)
    if isinstance(error, ServoscopeError):
        return message
    if isinstance(error, MemoryError):
        return "out of memory; ask for fewer or smaller images"
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        full = "; free some and repeat the command, a run with --resume"
        return f"{where}{error.strerror or message}{full if error.errno == ENOSPC else ''}"
    return f"unexpected {type(error).__name__}: {message}; --debug shows where it came from"


def _fail(message: str, code: int) -> int:
    print_message(f"servoscope: {message}")
    return code


def _print_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print_message(f"servoscope: warning: {message}")


if __name__ == "__main__":
    sys.exit(main())
