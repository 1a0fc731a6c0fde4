"""The commands by name, each loaded when it is asked for, and the parser of their arguments."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import partial, wraps
from importlib import import_module
from typing import Any

from tyro.conf import FlagCreatePairsOff
from tyro.extras import SubcommandApp

DESCRIPTION = """Vision-based robot positioning: which image features inform which degree of
freedom, and how accurately. Begin with: servoscope study. Every command also takes --debug, which
shows where an error came from, and --workers N or --dask tcp://HOST:PORT, which share its work with
dask workers that are started here or run elsewhere; --version prints the version."""

COMMANDS = {
    "study": "study:study",
    "acquire": "acquire:acquire",
    "assess": "assess:assess",
    "import": "import_images:import_commands",
    "train": "train:train",
    "rehearse": "rehearse:rehearse",
    "position": "position:position",
    "view": "view:view",
    "aim": "aim:aim",
    "export": "export:export",
    "serve": "serve:serve",
    "benchmark": "benchmark_positioning:benchmark_commands",
    "sensitivity": "sensitivity:sensitivity",
    "report": "study:report",
    "info": "info:info",
    "completion": "completion:completion",
}
"""Where each command stands: module of ``commands`` and function, loaded when it is asked for."""

GROUPS = {
    "import": "Make a data set of your own images and poses.",
    "benchmark": "Compare servoscope with what else there is.",
}
"""Commands that have commands of their own, whose function returns those by name."""


def named(arguments: Sequence[str]) -> tuple[list[str], str | None, Collection[str]]:
    """The command that arguments begin with.

    Returns
    -------
    path : list of str
        Its words; none where the arguments begin with an option.
    unknown : str, optional
        The word after them where a command is wanted and there is none of that name.
    names : collection of str
        The commands that there are instead.
    """
    path: list[str] = []
    names: Collection[str] = COMMANDS
    for argument in arguments:
        if argument.startswith("-"):
            break
        if argument not in names:
            return path, argument, names
        path.append(argument)
        if argument not in GROUPS:
            break
        names = _load(argument)()
    return path, None, names


def parse(
    path: Sequence[str], arguments: Sequence[str], *, whole: bool = False
) -> Callable[[], None]:
    """The command of a path with its arguments, ready to run.

    Exits where they are wrong, or ask for help. With `whole` the parser knows all commands, for
    completion.
    """
    command: Callable[[], None] = _app(path, whole=whole).cli(
        prog="servoscope",
        description=DESCRIPTION,
        args=arguments,
        config=(FlagCreatePairsOff,),
    )
    return command


def _app(path: Sequence[str], *, whole: bool) -> SubcommandApp:
    """The command that is asked for, alone; without one a list of all, or the `whole`."""
    app = SubcommandApp()
    for name in path[:1] or COMMANDS:
        if not (path or whole):
            app.command(name=name, help=GROUPS.get(name) or _summary(name))(lambda: None)
        elif name in GROUPS:
            group, commands = SubcommandApp(), _load(name)()
            for inner in path[1:] or commands:
                group.command(name=inner)(_later(commands[inner]))
            app.command(group, name=name, help=GROUPS[name])
        else:
            app.command(name=name)(_later(_load(name)))
    return app


def _summary(name: str) -> str:
    return (_load(name).__doc__ or "").splitlines()[0]


def _load(name: str) -> Callable[..., Any]:
    """The function of a command, or what makes those of a group by name."""
    module, _, function = COMMANDS[name].partition(":")
    loaded: Callable[..., Any] = getattr(import_module(f"servoscope.commands.{module}"), function)
    return loaded


def _later(command: Callable[..., None]) -> Callable[..., Callable[[], None]]:
    """What takes the arguments of a command and returns the command with them."""

    @wraps(command)
    def asked_for(*arguments: Any, **options: Any) -> Callable[[], None]:
        return partial(command, *arguments, **options)

    return asked_for
