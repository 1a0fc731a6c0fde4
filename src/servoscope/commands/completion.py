"""``servoscope completion``."""

from __future__ import annotations

import io
from contextlib import redirect_stdout, suppress
from typing import Annotated, Literal

from tyro.conf import Positional, arg

Shell = Positional[
    Annotated[Literal["bash", "zsh", "fish"], arg(metavar="SHELL", help="bash, zsh or fish.")]
]


_CHANGES = (
    # tyro completes files after options alone; here also where a folder stands without one.
    (
        "    for completion in completions:\n        print(completion)",
        """    is_option = ''.join(words[current_index : current_index + 1]).startswith('-')
    if not is_option and not any(text[:1].isalnum() for text in completions):
        completions = ['__TYRO_COMPLETE_FILES__']
    for completion in completions:
        print(completion.replace(chr(10), ' '))""",
    ),
    # The word that is written is not among those of fish.
    ('"$pycode" $words $current', '"$pycode" $words (commandline -ct) $current'),
    # What bash completes by itself has slashes after folders, and quotes.
    ('COMPREPLY=($(compgen -f -- "$cur"))', "COMPREPLY=()"),
    ("complete -F", "complete -o default -F"),
)


def completion(shell: Shell) -> None:
    """Print what completes commands, options and files in a shell.

    Example: servoscope completion bash > ~/.local/share/bash-completion/completions/servoscope

    Example: servoscope completion zsh > ~/.zfunc/_servoscope

    Example: servoscope completion fish > ~/.config/fish/completions/servoscope.fish
    """
    from servoscope.commands.catalogue import parse

    script = io.StringIO()
    with redirect_stdout(script), suppress(SystemExit):
        parse((), ["--tyro-print-completion", shell], whole=True)
    text = script.getvalue()
    for old, new in _CHANGES:
        text = text.replace(old, new)
    print(text)
