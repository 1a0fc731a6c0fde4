"""The command line."""

from __future__ import annotations

import atexit
import gc
import io
import logging
import os
import re
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext, redirect_stderr
from typing import Any

from servoscope import __version__
from servoscope.commands.catalogue import named, parse
from servoscope.commands.streams import (
    discard_unwritten,
    prepare_streams,
    print_message,
    reason_of,
)
from servoscope.commands.usage import nearest, usage_line
from servoscope.wording import printable

_CLUSTER_OPTIONS = {
    "--dask": "the address of a scheduler, such as tcp://192.0.2.7:8786",
    "--workers": "a number of workers, such as 4",
}
_OF_OTHERS = r"\d+ tasks (which|have)|Sending large graph|A worker stopped while"
"""Warnings of joblib and dask whose advice is for programs, not for users of commands."""

_ENDS = (signal.SIGINT, signal.SIGTERM)
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
        0 done, 1 failed with one line on standard error, 130 interrupted by Ctrl-C
        or SIGTERM. Wrong usage exits with 2.
    """
    is_whole_process = arguments is None
    if is_whole_process:
        gc.set_threshold(700, 10, 100)  # imports provoke collections, a fifth of their time
        atexit.register(gc.freeze)  # as one at the end would, of what ends anyway
        prepare_streams()
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # as tidy as Ctrl-C
        sys.warnoptions.append("ignore:resource_tracker:UserWarning")  # of a process that clears up
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    cluster, arguments = _cluster_options(arguments)
    warnings.showwarning = _print_warning
    warnings.filterwarnings("ignore", message=_OF_OTHERS)
    for noisy in ("asyncio", "distributed"):
        logging.getLogger(noisy).setLevel(logging.CRITICAL)
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # it prints names of files as they are
    try:
        _run(arguments or ["--help"], cluster)
        sys.stdout.flush()
        if is_whole_process:  # they have nothing to do, but take a second to leave
            _stop_processes()
    except KeyboardInterrupt:
        return _end(is_whole_process)
    except BrokenPipeError:
        discard_unwritten()
        return 1
    except Exception as error:
        if debug:
            print(printable(traceback.format_exc()), end="", file=sys.stderr)
        code = _fail(reason_of(error), 1)
        discard_unwritten()
        return code
    return 0


def _end(is_whole_process: bool) -> int:
    """Stop what still runs, say so, and return the code of the end; nothing disturbs that."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in _ENDS}
    _stop_processes()
    code = _fail("interrupted; what is finished is kept", 130)
    if not is_whole_process:
        for number, handler in before.items():
            signal.signal(number, handler)
    return code


def _stop_processes() -> None:
    """Stop processes that share work, if any may have been started.

    Nothing is imported for it: an import that was interrupted cannot always be repeated.
    """
    if (processes := sys.modules.get("servoscope.processes")) is not None:
        processes.stop_processes()


def _cluster_options(arguments: list[str]) -> tuple[dict[str, str], list[str]]:
    """What ``--dask`` and ``--workers`` say, by name, and the other arguments; exits where they say
    nothing.
    """
    said, others, left = {}, [], iter(arguments)
    for argument in left:
        name, equals, value = argument.partition("=")
        if name not in _CLUSTER_OPTIONS:
            others.append(argument)
            continue
        said[name] = value = value if equals else next(left, "")
        if not value or (name == "--workers" and not (value.isascii() and value.isdigit())):
            wanted = _CLUSTER_OPTIONS[name] + (f", got {value!r}" if value else "")
            sys.exit(_fail(f"{name} needs {wanted}. See servoscope --help.", 2))
    return said, others


def _sharing(said: dict[str, str]) -> AbstractContextManager[object]:
    """What shares the work of a command with a cluster, if one is named."""
    if not said:
        return nullcontext()
    from servoscope.cluster import on_cluster

    workers = said.get("--workers")
    return on_cluster(said.get("--dask"), None if workers is None else int(workers))


def _run(arguments: Sequence[str], cluster: dict[str, str]) -> None:
    if list(arguments) == ["--version"]:
        print(f"servoscope {__version__}")
        return
    command = _asked_for(arguments)
    from servoscope.storage.folders import remove_abandoned

    remove_abandoned()
    with _sharing(cluster):
        command()


def _asked_for(arguments: Sequence[str]) -> Callable[[], None]:
    """The command that arguments name, with its own; exits where they name none."""
    path, unknown, names = named(arguments)
    if unknown is not None:
        prog = " ".join(["servoscope", *path])
        _fail(f"there is no command {unknown!r}.{nearest(unknown, names)} See {prog} --help.", 2)
        sys.exit(2)
    errors = io.StringIO()
    try:
        with redirect_stderr(errors):
            return parse(path, arguments)
    finally:
        if errors.getvalue():
            box = _COLOURS.sub("", errors.getvalue())
            print_message(f"servoscope: {usage_line(box, ' '.join(['servoscope', *path]))}")


def _fail(message: str, code: int) -> int:
    print_message(f"servoscope: {message}")
    return code


def _print_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print_message(f"servoscope: warning: {message}")


if __name__ == "__main__":
    sys.exit(main())
