"""``servoscope import``: one command for each format."""

from collections.abc import Callable
from typing import Any

from tyro.conf import OmitArgPrefixes

from servoscope.commands.options import DataSetOut, Dofs, Force, Json, Source, with_dofs
from servoscope.errors import PluginError
from servoscope.formats.options import ImportOptions
from servoscope.formats.registry import FORMATS, Format


def import_command(name: str, format_: Format) -> Callable[..., None]:
    """The command that imports one format."""

    def command(
        src: Source,
        out: DataSetOut,
        options: OmitArgPrefixes[format_.options],  # type: ignore[name-defined]
        dofs: Dofs = None,
        force: Force = False,
        json: Json = False,
    ) -> None:
        from servoscope.commands.info import print_data_set
        from servoscope.commands.output import progress_bar
        from servoscope.data.folder import check_free, writing

        with writing(out, replace=force) as place:
            check_free(out, force=force)
            with progress_bar("images", None) as advance:
                data = format_.read(src, options, advance)
            with_dofs(data, dofs).save(place)
            del data  # what is described is read from the folder
        print_data_set(out, as_json=json)

    shown = "\n\n".join(f"servoscope import {name} SRC OUT {e}" for e in format_.examples)
    command.__doc__ = (
        f"Import {format_.summary}, and write a data set folder. For example:\n\n{shown}"
    )
    return command


def import_commands() -> dict[str, Callable[..., None]]:
    """The command of every format, by name; that of a plug-in that fails says so when called."""
    try:
        names = list(FORMATS)
    except PluginError as error:
        return {name: _failing(name, error) for name in FORMATS.built_in}
    commands = {}
    for name in names:
        try:
            commands[name] = import_command(name, FORMATS[name])
        except PluginError as error:
            commands[name] = _failing(name, error)
    return commands


def _failing(name: str, error: PluginError) -> Callable[..., None]:
    def read(*_: Any) -> Any:
        raise error

    return import_command(name, Format("what cannot be read", ImportOptions, read))
