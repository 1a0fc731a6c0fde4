"""The command line."""

from __future__ import annotations

import logging
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from errno import ENOSPC
from typing import Any

from tyro.conf import FlagCreatePairsOff
from tyro.extras import SubcommandApp

from servoscope import __version__
from servoscope.errors import ServoscopeError
from servoscope.processes import stop_processes

DESCRIPTION = """Vision-based robot positioning: which image features tell about which degree of
freedom, and how accurately. Begin with: servoscope study. Every command also takes --debug, which
shows where an error came from; --version tells the version."""


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
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    if arguments == ["--version"]:
        print(f"servoscope {__version__}")
        return 0
    warnings.showwarning = _print_warning
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)
    warnings.filterwarnings("ignore", message=r"\d+ tasks (which|have)")
    try:
        app = _app()
        app.cli(
            prog="servoscope",
            description=DESCRIPTION,
            args=arguments or ["--help"],
            config=(FlagCreatePairsOff,),
        )
        sys.stdout.flush()
    except KeyboardInterrupt:
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second would disturb the end
        stop_processes()
        code = _fail("interrupted; what is finished is kept, and can be gone on with", 130)
        if not is_whole_process:
            signal.signal(signal.SIGINT, before)
        return code
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        if debug:
            traceback.print_exc()
        return _fail(_one_line(error), 1)
    return 0


def _app() -> SubcommandApp:
    from servoscope.commands.acquire import acquire
    from servoscope.commands.assess import assess
    from servoscope.commands.benchmark_positioning import benchmark_positioning
    from servoscope.commands.import_images import import_commands
    from servoscope.commands.info import info
    from servoscope.commands.position import position
    from servoscope.commands.report import report
    from servoscope.commands.sensitivity import sensitivity
    from servoscope.commands.study import study
    from servoscope.commands.train import train

    app, formats, benchmarks = SubcommandApp(), SubcommandApp(), SubcommandApp()
    for name, import_format in import_commands().items():
        formats.command(name=name)(import_format)
    app.command(study)
    app.command(acquire)
    app.command(assess)
    app.command(formats, name="import", help="Make a data set of your own images and poses.")
    app.command(train)
    app.command(position)
    benchmarks.command(name="positioning")(benchmark_positioning)
    app.command(benchmarks, name="benchmark", help="Compare servoscope with what else there is.")
    app.command(sensitivity)
    app.command(report)
    app.command(info)
    return app


def _one_line(error: Exception) -> str:
    message = " ".join(str(error).split())
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
    print(f"servoscope: {message}", file=sys.stderr)
    return code


def _print_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"servoscope: warning: {' '.join(str(message).split())}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
