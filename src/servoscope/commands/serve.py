"""``servoscope serve``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from servoscope.commands.options import Model
from servoscope.errors import InvalidInputError

TOKEN = "SERVOSCOPE_TOKEN"  # noqa: S105  the name of the variable
_LONGEST_TOKEN = 4096

Names = Annotated[
    str,
    arg(
        metavar="NAME,...",
        help="Names by which the service may be called, besides addresses and localhost.",
    ),
]


def serve(
    model: Model,
    host: str = "127.0.0.1",
    port: int = 8077,
    token_file: Path | None = None,
    names: Names = "",
    bit_depth: int | None = None,
) -> None:
    """Answer over HTTP where images were taken, until Ctrl-C.

    POST /estimate takes the bytes of an image file and gives the displacement as JSON; GET / shows
    the rest. It listens to this machine alone unless another --host is named, which needs a token:
    in a file, or in the variable SERVOSCOPE_TOKEN. What is sent is not encrypted.

    Example: servoscope serve model

    Example: servoscope serve model --host 0.0.0.0 --token-file token --names cell-7

    Args:
        host: Address to listen at.
        port: Port to listen at; 0 for any that is free.
        token_file: File whose content requests must bring as Authorization: Bearer.
        bit_depth: Bits that the values of 16-bit images fill, 9 to 16; without it they are
            refused.
    """
    import signal

    from servoscope.commands.streams import print_message
    from servoscope.positioning.model import PositioningModel
    from servoscope.processes import one_blas_thread
    from servoscope.service.answers import Answers
    from servoscope.service.server import Server

    if bit_depth is not None and not 9 <= bit_depth <= 16:
        raise InvalidInputError(f"--bit-depth must be from 9 to 16, got {bit_depth}.")
    token = _token(token_file)
    named = tuple(name.strip() for name in names.split(",") if name.strip())
    with one_blas_thread():
        answers = Answers(PositioningModel.load(model), bit_depth)
        with Server(answers, host, port, token=token, names=named) as server:
            print_message(f"servoscope: serving {model} at {server.url}, until Ctrl-C")
            before = signal.signal(signal.SIGTERM, signal.default_int_handler)
            try:
                server.serve_forever()
            except KeyboardInterrupt:
                print_message("servoscope: stopped")
            finally:
                signal.signal(signal.SIGTERM, before)


def _token(file: Path | None) -> str | None:
    from servoscope.storage.reading import read_bytes

    if file is None:
        return os.environ.get(TOKEN) or None
    content = read_bytes(file, InvalidInputError, _LONGEST_TOKEN)
    try:
        return content.decode("ascii").strip()
    except UnicodeDecodeError as error:
        raise InvalidInputError(f"{file} must hold a token of ASCII characters.") from error
