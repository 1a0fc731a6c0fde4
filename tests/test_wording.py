"""Text on one line, whatever it came from."""

import pytest

from servoscope.wording import one_line


class Speechless(Exception):
    def __init__(self, error: BaseException) -> None:
        self.error = error

    def __str__(self) -> str:
        raise self.error


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("a\n b\r\nc\td", "a b c d"),
        ("\x1b[2Jred\x07\u202e", "?[2Jred??"),
        (ValueError("line\none"), "line one"),
        (ValueError(), "ValueError"),
        (Speechless(RuntimeError()), "Speechless"),
        (Speechless(KeyboardInterrupt()), "Speechless"),
        ("\ud800", "?"),
        (3.5, "3.5"),
    ],
)
def test_any_value_is_one_line_that_a_terminal_can_show(value, text):
    assert one_line(value) == text


def test_a_long_text_is_cut_short():
    assert one_line("x" * 301) == "x" * 297 + "..."
    assert one_line("x" * 300) == "x" * 300
    assert one_line("x" * 30, longest=10) == "xxxxxxx..."
