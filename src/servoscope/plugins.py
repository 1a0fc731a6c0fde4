"""Registries: what is built in, by name, and what installed packages add by entry points."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar

from servoscope.errors import PluginError
from servoscope.wording import one_line

T = TypeVar("T")


class Registry(Mapping[str, T], Generic[T]):
    """Objects by name: built in, or added by installed packages.

    A package adds one by an entry point of the group, such as ``servoscope.features``; it is loaded
    when it is first asked for. `adapt` makes of a name and of what was loaded an object as the
    built-in ones are, or raises a ValueError or TypeError.

    Examples
    --------
    >>> shapes = Registry("servoscope.examples", {"round": 1}, lambda name, loaded: loaded)
    >>> shapes["round"], "square" in shapes, list(shapes)
    (1, False, ['round'])
    """

    def __init__(
        self, group: str, built_in: Mapping[str, T], adapt: Callable[[str, Any], T]
    ) -> None:
        self.group, self.built_in, self.adapt = group, dict(built_in), adapt
        self._loaded: dict[str, T] = {}

    def __getitem__(self, name: str) -> T:
        plugins = self._plugins()
        if name in self.built_in:
            return self.built_in[name]
        if name not in self._loaded:
            self._loaded[name] = self._load(plugins[name])
        return self._loaded[name]

    def __contains__(self, name: object) -> bool:
        return name in self.built_in or name in self._plugins()

    def __iter__(self) -> Iterator[str]:
        return iter([*self.built_in, *self._plugins()])

    def __len__(self) -> int:
        return len(self.built_in) + len(self._plugins())

    def _plugins(self) -> dict[str, EntryPoint]:
        """The entry points by name.

        Raises
        ------
        PluginError
            If one has the name of a built-in object, or of that of another package.
        """
        found: dict[str, EntryPoint] = {}
        for point in _points(self.group, tuple(sys.path)):
            other = found.get(point.name)
            if other is not None and other.value == point.value:
                continue  # found twice on the path
            if point.name in self.built_in or other is not None:
                owner = "servoscope" if other is None else f"the package {_package(other)}"
                raise PluginError(
                    f"The package {_package(point)} adds {point.name!r} to {self.group}, a name "
                    f"that {owner} has already; rename its entry point, or uninstall it."
                )
            found[point.name] = point
        return found

    def _load(self, point: EntryPoint) -> T:
        try:
            return self.adapt(point.name, point.load())
        except Exception as error:  # what a package does when it is imported may fail in any way
            raise PluginError(
                f"The plug-in {point.name!r} ({point.value}) of the package {_package(point)} "
                f"cannot be loaded ({type(error).__name__}: {one_line(error)}); mend the package, "
                "or uninstall it."
            ) from error


@lru_cache(maxsize=32)
def _points(group: str, path: tuple[str, ...]) -> list[EntryPoint]:
    """The entry points of a group in the order of their names; looked for once a path."""
    return sorted(entry_points(group=group), key=lambda point: (point.name, point.value))


def _package(point: EntryPoint) -> str:
    return "?" if point.dist is None else f"{point.dist.name} {point.dist.version}"
