from servoscope.compiled import compiled

SOURCE = "def double(x):\n    return 2 * x\n"


def test_a_function_that_cannot_be_kept_on_disk_is_compiled_all_the_same():
    names = {}
    exec(compile(SOURCE, "<nowhere>", "exec"), names)  # noqa: S102
    assert compiled()(names["double"])(21) == 42
