"""Wrong usage is one line; a shell completes commands, options and files."""

import re
import subprocess
import sys
from contextlib import redirect_stdout

import pytest

from servoscope.cli import main
from servoscope.commands.catalogue import COMMANDS


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ("inf", "there is no command 'inf'. Did you mean info? See servoscope --help."),
        ("import foldr a b", "no command 'foldr'. Did you mean folder? See servoscope import --h"),
        (
            "acquire out --schedul 3",
            "acquire has no option --schedul. Did you mean --schedule? See",
        ),
        ("assess d --tolerence t=1mm", "option --tolerence. Did you mean --tolerance? See"),
        ("import folder a b --pose x", "import folder has no option --pose. Did you mean --poses?"),
        ("train d --quikc", "train has no option --quikc. See servoscope train --help."),
        ("--jobs 3", "servoscope has no option --jobs. See servoscope --help."),
        ("info a b", "info has no place for 'b'. See servoscope info --help."),
        ("study --n-images abc", "--n-images: invalid literal for int() with base 10: 'abc'. See"),
        ("study --out", "Missing value for argument '--out'"),
        ("export", "Missing from servoscope export: SRC FILE. See servoscope export --help."),
        ("acquire o --part foo", "invalid choice 'foo' for argument '--part'"),
        ("study --protocol x", "Expected one of 'both', 'honest', 'paper'. See"),
        ("import folder a b --units inch", "Expected one of 'm', 'mm'. See"),
        ("import folder a b --memory 1KB", "servoscope: memory must be 1MB or more"),
        ("study --cells abc", "servoscope: --cells must be INT, got 'abc'. See"),
        ("acquire o --n-images 3 --schedule 3@1", "--n-images and --schedule are not allowed"),
        ("info --dask", "--dask needs the address of a scheduler, such as tcp://192.0.2.7:8786."),
        ("--workers= info", "--workers needs a number of workers, such as 4. See"),
        ("--workers few info", "--workers needs a number of workers, such as 4, got 'few'. See"),
        ("benchmark", "Expected one of {positioning}. See servoscope benchmark --help."),
    ],
)
def test_wrong_usage_is_one_line_with_the_nearest_name_of_this_command(arguments, line, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments.split())
    out, err = capsys.readouterr()
    assert (caught.value.code, out) == (2, "")
    assert err.startswith("servoscope: ")
    assert err.count("\n") == 1
    assert line in err


def test_help_lists_every_command_with_a_line(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["--help"])
    assert caught.value.code == 0
    listed = re.findall(r"• ([\w-]+) +\w+", capsys.readouterr().out)
    assert listed == list(COMMANDS)


def test_help_reads_no_library_of_numbers():
    code = (
        "import sys; from servoscope.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: print({'numpy', 'scipy', 'rich', 'joblib', 'cv2'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"


@pytest.fixture(scope="module")
def bash(tmp_path_factory):
    """Completes words of a command line in bash; nothing where that completes files itself."""
    folder = tmp_path_factory.mktemp("completion")
    with open(folder / "script", "w") as script, redirect_stdout(script):
        assert main(["completion", "bash"]) == 0

    def complete(*words: str) -> set[str]:
        line = " ".join(f"'{word}'" for word in words)
        code = (
            f"source ./script; COMPREPLY=(); COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; "
            "registered=$(complete -p servoscope); [[ $registered == *'-o default'* ]] && "
            "$(echo $registered | sed 's/.*-F \\([^ ]*\\) .*/\\1/'); "
            "printf '%s\\n' \"${COMPREPLY[@]}\""
        )
        done = subprocess.run(
            ["bash", "-c", code], cwd=folder, capture_output=True, text=True, check=True
        )
        assert not done.stderr
        return set(done.stdout.splitlines()) - {""}

    return complete


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("servoscope", "acq"), {"acquire"}),
        (("servoscope", ""), {*COMMANDS, "-h", "--help"}),
        (("servoscope", "acquire", "out", "--sched"), {"--schedule"}),
        (("servoscope", "import", "ne"), {"nerfstudio"}),
        (("servoscope", "import", "tum", "a", "b", "--skip"), {"--skip-bad"}),
        (("servoscope", "acquire", "out", "--part", "tex"), {"textured_plane"}),
        (("servoscope", "info", "ce"), set()),
        (("servoscope", "info", ""), set()),
        (("servoscope", "info", "cell", "--js"), {"--json"}),
        (("servoscope", "train", "cell", "--out", "ce"), set()),
    ],
)
def test_bash_completes(words, expected, bash):
    assert bash(*words) == expected


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_have_a_script(shell, capsys):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert "servoscope" in script
    assert "--schedule" in script
    assert ".isalnum()" in script  # files are completed where a folder is named
