"""The rooms of the package, the one way through them, and what no file may hold."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import servoscope

SOURCE = Path(servoscope.__file__).parent
FILES = sorted(SOURCE.rglob("*.py"))


@pytest.fixture(scope="module")
def trees():
    return {file.relative_to(SOURCE): ast.parse(file.read_text()) for file in FILES}


# From left to right: a module imports from rooms to its left, or from its own.
ROOMS = (
    ("errors", "wording"),
    ("storage", "cluster"),
    ("processes", "compiled", "arrays", "plugins"),
    ("poses",),
    ("dofs", "report"),
    ("kernels",),
    ("data",),
    ("scene", "formats"),
    ("robots",),
    ("features",),
    ("selection",),
    ("regression",),
    ("keyframe",),
    ("pipeline",),
    ("positioning",),
    ("export", "service"),
    ("acquisition",),
    ("sensitivity",),
    ("scoreboard",),
    ("rehearsal",),
    ("viewer",),
    ("assessment",),
    ("study",),
    ("commands",),
    ("cli",),
    ("__main__",),
)
RANK = {room: rank for rank, rooms in enumerate(ROOMS) for room in rooms}
EDGE = {"scene", "formats", "robots", "acquisition"}
CORE = {"features", "kernels", "selection", "regression", "keyframe"}


def room_of(path):
    return path.parts[0].removesuffix(".py")


def imported_rooms(tree):
    """Rooms of servoscope that a module imports, wherever in it the import stands."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"line {node.lineno}: import absolutely"
            inside = [f"{node.module}.{alias.name}" for alias in node.names]
            names = inside if node.module == "servoscope" else [node.module]
        else:
            continue
        for name in names:
            package, _, rest = name.partition(".")
            if package == "servoscope" and rest != "__version__":
                yield rest.split(".")[0]


def may_import(room, other):
    if room in CORE and other in EDGE:
        return False
    return other == room or (other in RANK and RANK[other] < RANK[room])


def test_there_is_a_place_for_every_module(trees):
    assert {room_of(path) for path in trees} - {"__init__"} <= set(RANK)


def test_imports_go_one_way(trees):
    wrong = [
        f"{path} imports {room}"
        for path, tree in trees.items()
        for room in imported_rooms(tree)
        if not may_import(room_of(path), room)
    ]
    assert not wrong


@pytest.mark.parametrize(
    ("room", "source", "allowed"),
    [
        ("poses", "from servoscope.errors import InvalidInputError", True),
        ("poses", "from servoscope.data.images import PoseImageSet", False),
        ("features", "def f():\n    import servoscope.scene.cylinder_head", False),
        ("features", "from servoscope import formats", False),
        ("selection", "from servoscope import MutualInfoSelector", False),
        ("scene", "from servoscope.formats import read_tum", False),
        ("study", "from servoscope.study.paper import StudyConfig", True),
    ],
)
def test_a_wrong_import_would_be_seen(room, source, allowed):
    assert all(may_import(room, other) for other in imported_rooms(ast.parse(source))) == allowed


def test_images_are_taken_and_a_keyframe_drives_a_robot_without_scikit_learn():
    program = (
        "import sys, servoscope.acquisition.simulated, servoscope.acquisition.recording, "
        "servoscope.data.checks, servoscope.positioning.keyframe_model, "
        "servoscope.positioning.look_and_move, servoscope.scoreboard.trial; "
        "print({'sklearn', 'pandas', 'matplotlib'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout == "set()\n"


PUBLISHING = [
    file for file in FILES if file.name == "__init__.py" and "__all__" in file.read_text()
]


@pytest.mark.parametrize("file", PUBLISHING, ids=lambda file: file.parent.name)
def test_every_public_name_exists_and_no_module_hides_it(file):
    package = ".".join(file.parent.relative_to(SOURCE.parent).parts)
    for module in file.parent.glob("[a-z]*.py"):
        importlib.import_module(f"{package}.{module.stem}")
    public = importlib.import_module(package)
    assert public.__all__
    for name in public.__all__:
        assert not isinstance(getattr(public, name), ModuleType)


def is_unsafe(node):
    """Whether a node runs text as code, or reads or writes pickled objects."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        names = [getattr(node, "module", None) or "", *(alias.name for alias in node.names)]
        return any(name.split(".")[0] in {"pickle", "cloudpickle", "dill"} for name in names)
    if not isinstance(node, ast.Call):
        return False
    called = ast.unparse(node.func)
    pickles = any(
        k.arg == "allow_pickle"
        and not (isinstance(k.value, ast.Constant) and k.value.value is False)
        for k in node.keywords
    )
    return pickles or called in {"eval", "exec", "joblib.load", "joblib.dump"}


def test_nothing_is_pickled_and_no_text_is_run(trees):
    unsafe = [
        f"{path}:{node.lineno}"
        for path, tree in trees.items()
        for node in ast.walk(tree)
        if is_unsafe(node)
    ]
    assert not unsafe


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from pickle import loads",
        "eval(x)",
        "exec('y')",
        "joblib.load(path)",
        "np.load(path, allow_pickle=True)",
        "np.load(path, allow_pickle=trusted)",
    ],
)
def test_what_is_unsafe_would_be_seen(source):
    assert any(is_unsafe(node) for node in ast.walk(ast.parse(source)))
