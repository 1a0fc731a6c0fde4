"""Versions of Python and of what servoscope needs: ``nox --list``."""

import shutil
import tempfile
from pathlib import Path

import nox

PYTHONS = ("3.11", "3.12", "3.13", "3.14")
PLATFORMS = (
    "x86_64-manylinux_2_28",
    "aarch64-manylinux_2_28",
    "aarch64-apple-darwin",
    "x86_64-apple-darwin",
    "x86_64-pc-windows-msvc",
)
EXTRAS = ("arm", "bags", "cloud", "dask", "export", "lerobot", "gentl", "ros", "ur", "view")
WHEELS = ("--only-binary", ":all:", "--no-binary", "servoscope")

nox.options.default_venv_backend = "uv"
nox.options.envdir = str(Path(tempfile.gettempdir()) / "servoscope-nox")
nox.options.error_on_missing_interpreters = False
nox.options.sessions = ["lint", "tests"]


def run_tests(session: nox.Session, *options: str) -> None:
    """Run the tests, those that are named or all, with compiled kernels of these versions alone."""
    kernels = {"NUMBA_CACHE_DIR": str(Path(session.virtualenv.location) / "kernels")}
    session.run("python", "-m", "pytest", *options, *session.posargs, env=kernels)


@nox.session(python=PYTHONS)
def tests(session: nox.Session) -> None:
    """Run the tests on every Python that is found."""
    session.install(*WHEELS, ".[test]")
    run_tests(session)


@nox.session(python="3.11")
def lowest(session: nox.Session) -> None:
    """Run the tests with the lowest version of everything that pyproject.toml allows."""
    session.install("--resolution", "lowest-direct", *WHEELS, ".[test]")
    run_tests(session, "-W", "ignore::DeprecationWarning")  # of old packages, in each other


@nox.session(python="3.11")
def newest(session: nox.Session) -> None:
    """Run the tests with the newest version of everything."""
    session.install("--upgrade", *WHEELS, ".[test]")
    run_tests(session)


@nox.session(python=False)
def wheels(session: nox.Session) -> None:
    """Find out, without any of these machines, whether wheels alone are enough there."""

    def are_enough(python: str, platform: str, *extras: str) -> bool:
        options = [option for extra in extras for option in ("--extra", extra)]
        said = session.run(
            "uv", "pip", "compile", "--quiet", "--only-binary", ":all:",
            "--python-version", python, "--python-platform", platform, *options,
            "pyproject.toml", external=True, silent=True, success_codes=[0, 1],
            env={"MACOSX_DEPLOYMENT_TARGET": "14.0"},
        )  # fmt: skip
        return "No solution found" not in str(said)

    lacking = []
    for python in PYTHONS:
        for platform in PLATFORMS:
            if not are_enough(python, platform, *EXTRAS):
                for extra in EXTRAS:
                    if not are_enough(python, platform, extra):
                        lacking.append(f"{python} {platform} {extra}")
                if not are_enough(python, platform):
                    session.error(f"servoscope itself needs a compiler on {python} {platform}.")
    session.log("extras without wheels: " + ("; ".join(lacking) or "none"))


@nox.session(python=PYTHONS)
def install(session: nox.Session) -> None:
    """Install the built wheel without a compiler, and use it."""
    place = Path(session.create_tmp())
    shutil.rmtree(place / "dist", ignore_errors=True)
    session.run("uv", "build", "--quiet", "--wheel", "--out-dir", place / "dist", external=True)
    session.install("--only-binary", ":all:", str(next((place / "dist").glob("*.whl"))))
    session.run("servoscope", "--help", silent=True)
    small = ("--n-images", "2", "--image-size", "16", "--force")
    session.run("servoscope", "acquire", str(place / "small"), *small)
    session.run("servoscope", "info", str(place / "small"))


@nox.session
def lint(session: nox.Session) -> None:
    """Check style, types and the citation."""
    session.install(*WHEELS, ".[dev]")
    session.run("ruff", "check")
    session.run("ruff", "format", "--check")
    session.run("mypy")
    session.run("uvx", "cffconvert", "--validate", external=True)


@nox.session
def docs(session: nox.Session) -> None:
    """Build the site, with warnings as errors."""
    session.install(*WHEELS, ".[docs]")
    session.run("python", "-m", "sphinx", "-W", "--keep-going", "--quiet", "docs", "build/site")
