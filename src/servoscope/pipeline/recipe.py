"""What predicts a degree of freedom."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from servoscope.errors import InvalidInputError
from servoscope.features.catalogue import FAMILIES
from servoscope.regression.registry import REGRESSORS


@dataclass(frozen=True)
class Recipe:
    """What predicts a degree of freedom: features and a regressor on them.

    Parameters
    ----------
    features : str or transformer
        Families of image features, joined by ``+``: names of `servoscope.features.catalogue`; or
        an object with ``fit(images, displacements)`` and ``transform(images)``.
    columns : tuple of str
        The features that are kept, by name or by pattern, such as ``"e_0?"``; ``{dof}`` stands for
        the degree of freedom. All of them if there are none.
    regressor : str or estimator
        A name in `servoscope.regression.REGRESSORS`. Only what has a name can be saved.
    settings : dict
        Parameters of the regressor, by name.

    Examples
    --------
    >>> recipe = Recipe("moments+log_polar", regressor="kernel_ridge")
    >>> Recipe.from_json(recipe.to_json()) == recipe, recipe.families
    (True, ('moments', 'log_polar'))
    """

    features: Any = "moments"
    columns: tuple[str, ...] = ()
    regressor: Any = "gaussian_process"
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The families by name, joined by ``+``; a transformer is named after its class."""
        return self.features if isinstance(self.features, str) else type(self.features).__name__

    @property
    def family_names(self) -> tuple[str, ...]:
        """The names of the families."""
        return tuple(self.name.split("+"))

    @property
    def families(self) -> tuple[Any, ...]:
        """The families, by name or as the transformer."""
        return self.family_names if isinstance(self.features, str) else (self.features,)

    def for_dof(self, dof: str) -> Recipe:
        """The same with the degree of freedom in its columns."""
        return replace(self, columns=tuple(name.replace("{dof}", dof) for name in self.columns))

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values.

        Raises
        ------
        InvalidInputError
            If the features or the regressor are an object.
        """
        for kind in ("features", "regressor"):
            if not isinstance(value := getattr(self, kind), str):
                raise InvalidInputError(
                    f"A recipe is saved with names, but its {kind} are a {type(value).__name__}; "
                    f"add it to the entry points of a package, as servoscope.{kind.rstrip('s')}s."
                )
        return {**asdict(self), "columns": list(self.columns)}

    @classmethod
    def from_json(cls, values: Any) -> Recipe:
        """The recipe of plain JSON values.

        Raises
        ------
        InvalidInputError
            If they are of no recipe, or name features or a regressor that there is not.
        """
        known = {one.name for one in fields(cls)}
        if (
            not isinstance(values, dict)
            or set(values) - known
            or not isinstance(values.get("features"), str)
            or not isinstance(values.get("settings", {}), dict)
        ):
            raise InvalidInputError(
                f"A recipe must be an object with {', '.join(sorted(known))}, got "
                f"{repr(values)[:80]}."
            )
        columns = values.get("columns", ())
        if not isinstance(columns, list | tuple) or not all(isinstance(c, str) for c in columns):
            raise InvalidInputError(
                f"The columns of a recipe must be names, got {repr(columns)[:80]}."
            )
        recipe = cls(**{**values, "columns": tuple(columns)})
        for names, registry, kind in (
            (recipe.family_names, FAMILIES, "features"),
            ((recipe.regressor,), REGRESSORS, "regressor"),
        ):
            for name in names:
                if name not in registry:
                    raise InvalidInputError(
                        f"There is no {kind} named {repr(name)[:80]}; there are "
                        f"{', '.join(registry)}."
                    )
        return recipe
