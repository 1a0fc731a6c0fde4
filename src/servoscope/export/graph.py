"""Graphs of ONNX operators, written as arithmetic on values that are not known yet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

OPSET = 18
"""That of ``ScatterElements`` with the reductions ``add`` and ``max``; onnxruntime 1.14 has it."""

IR_VERSION = 8
"""The form of the file that belongs to it."""

Scalar = float | int | bool


class Value:
    """What an operator of a graph gives.

    Arithmetic, comparisons and indices of whole numbers and slices make new ones, as of numpy's
    arrays. Numbers and arrays beside a value are constants of its type.
    """

    __array_ufunc__ = None  # numpy's arrays leave operators to this class

    def __init__(self, graph: Graph, name: str, dtype: DTypeLike) -> None:
        self.graph, self.name, self.dtype = graph, name, np.dtype(dtype)

    def __add__(self, other: Any) -> Value:
        return self._with("Add", self, other)

    def __radd__(self, other: Any) -> Value:
        return self._with("Add", other, self)

    def __sub__(self, other: Any) -> Value:
        return self._with("Sub", self, other)

    def __rsub__(self, other: Any) -> Value:
        return self._with("Sub", other, self)

    def __mul__(self, other: Any) -> Value:
        return self._with("Mul", self, other)

    def __rmul__(self, other: Any) -> Value:
        return self._with("Mul", other, self)

    def __truediv__(self, other: Any) -> Value:
        return self._with("Div", self, other)

    def __rtruediv__(self, other: Any) -> Value:
        return self._with("Div", other, self)

    def __matmul__(self, other: Any) -> Value:
        return self._with("MatMul", self, other)

    def __rmatmul__(self, other: Any) -> Value:
        return self._with("MatMul", other, self)

    def __neg__(self) -> Value:
        return self.graph.apply("Neg", self)

    def __gt__(self, other: Any) -> Value:
        return self._with("Greater", self, other, dtype=bool)

    def __lt__(self, other: Any) -> Value:
        return self._with("Less", self, other, dtype=bool)

    def __ge__(self, other: Any) -> Value:
        return self._with("GreaterOrEqual", self, other, dtype=bool)

    def __le__(self, other: Any) -> Value:
        return self._with("LessOrEqual", self, other, dtype=bool)

    def __and__(self, other: Any) -> Value:
        return self._with("And", self, other, dtype=bool)

    def __or__(self, other: Any) -> Value:
        return self._with("Or", self, other, dtype=bool)

    def __invert__(self) -> Value:
        return self.graph.apply("Not", self)

    def __getitem__(self, key: int | slice | tuple[int | slice, ...]) -> Value:
        keys = key if isinstance(key, tuple) else (key,)
        out, graph = self, self.graph
        cuts = [(k, part) for k, part in enumerate(keys) if part != slice(None)]
        for axis, part in reversed(cuts):
            if isinstance(part, slice):
                start, stop = part.start or 0, part.stop
                stop = np.iinfo(np.int64).max if stop is None else stop
                step = 1 if part.step is None else part.step
                wanted = (graph.constant([number]) for number in (start, stop, axis, step))
                out = graph.apply("Slice", out, *wanted)
            else:
                out = out.take(part, axis)
        return out

    def take(self, indices: ArrayLike | Value, axis: int = 0) -> Value:
        """Those at indices along an axis, which goes if they are a single number."""
        if not isinstance(indices, Value):
            indices = self.graph.constant(np.asarray(indices, np.int64))
        return self.graph.apply("Gather", self, indices, axis=axis)

    def reshape(self, *shape: int) -> Value:
        """The same in another shape."""
        return self.graph.apply("Reshape", self, self.graph.constant(np.array(shape, np.int64)))

    def transpose(self, *axes: int) -> Value:
        """With its axes in another order.

        onnxruntime merges the operator ``Transpose`` with products, and many versions then lack
        the product of double precision.
        """
        before = "abcd"[: len(axes)]
        after = "".join(before[axis] for axis in axes)
        return self.graph.apply("Einsum", self, equation=f"{before}->{after}")

    def cast(self, dtype: DTypeLike) -> Value:
        """As another type."""
        from onnx import helper

        to = helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
        return self.graph.apply("Cast", self, dtype=dtype, to=to)

    def sum(self, *axes: int) -> Value:
        """Over axes; over all, as a scalar, if none are given."""
        return self._reduced("ReduceSum", axes)

    def min(self, *axes: int) -> Value:
        """The least over axes, or over all."""
        return self._reduced("ReduceMin", axes)

    def max(self, *axes: int) -> Value:
        """The greatest over axes, or over all."""
        return self._reduced("ReduceMax", axes)

    def sqrt(self) -> Value:
        """Its square root."""
        return self.graph.apply("Sqrt", self)

    def norm(self) -> Value:
        """The length of all as one vector, a scalar."""
        return (self * self).sum().sqrt()

    def clip(self, least: float, most: float) -> Value:
        """No less than `least` and no more than `most`."""
        return minimum(maximum(self, least), most)

    def sorted(self, n: int) -> Value:
        """A vector of n numbers, the least first."""
        wanted = self.graph.constant([n])
        values, _ = self.graph.apply_many(
            "TopK", self, wanted, dtypes=(self.dtype, np.int64), largest=0
        )
        return values

    def scattered(self, indices: ArrayLike | Value, onto: Value, how: str, axis: int = 0) -> Value:
        """`onto` with these added to it, or as the maximum, where the indices say."""
        if not isinstance(indices, Value):
            indices = self.graph.constant(np.asarray(indices, np.int64))
        return self.graph.apply(
            "ScatterElements", onto, indices, self, dtype=onto.dtype, axis=axis, reduction=how
        )

    def _with(self, kind: str, a: Any, b: Any, dtype: DTypeLike | None = None) -> Value:
        a, b = (self.graph.like(x, self) for x in (a, b))
        return self.graph.apply(kind, a, b, dtype=dtype)

    def _reduced(self, kind: str, axes: tuple[int, ...]) -> Value:
        wanted = [self.graph.constant(np.array(axes, np.int64))] if axes else []
        return self.graph.apply(kind, self, *wanted, keepdims=0)


Body = Callable[[Value, list[Value]], tuple[Value | None, Sequence[Value], Sequence[Value]]]


class Graph:
    """A graph in the making."""

    def __init__(self) -> None:
        self._scopes: list[list[Any]] = [[]]
        self._first: list[Any] = []
        self._constants: dict[tuple[Any, ...], Value] = {}
        self._initializers: list[Any] = []
        self._fields: dict[str, Value] = {}
        self._n_names = 0

    def constant(self, array: ArrayLike) -> Value:
        """An array that is known; the same one is kept once."""
        from onnx import numpy_helper

        array = np.asarray(array)
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._constants:
            value = self._new(array.dtype)
            self._initializers.append(numpy_helper.from_array(array, value.name))
            self._constants[key] = value
        return self._constants[key]

    def field(self, array: ArrayLike) -> Value:
        """An array as float64, kept in single precision where that loses nothing."""
        from onnx import helper

        exact, rounded = np.asarray(array, float), np.asarray(array, np.float32)
        if (exact != rounded).any():
            return self.constant(exact)
        single = self.constant(rounded)
        if single.name not in self._fields:
            double = self._new(np.float64)
            to = helper.np_dtype_to_tensor_dtype(double.dtype)
            self._first.append(helper.make_node("Cast", [single.name], [double.name], to=to))
            self._fields[single.name] = double
        return self._fields[single.name]

    def like(self, x: Any, value: Value) -> Value:
        """A constant of a value's type; values as they are."""
        return x if isinstance(x, Value) else self.constant(np.asarray(x, value.dtype))

    def apply(
        self, kind: str, *inputs: Value, dtype: DTypeLike | None = None, **attributes: Any
    ) -> Value:
        """What an operator gives, of its first input's type unless another is named."""
        known = inputs[0].dtype if dtype is None else dtype
        (out,) = self.apply_many(kind, *inputs, dtypes=(known,), **attributes)
        return out

    def apply_many(
        self, kind: str, *inputs: Value | None, dtypes: Sequence[DTypeLike], **attributes: Any
    ) -> list[Value]:
        """All that an operator gives."""
        from onnx import helper

        out = [self._new(dtype) for dtype in dtypes]
        names = ["" if value is None else value.name for value in inputs]
        made = [value.name for value in out]  # some versions of onnxruntime want nodes named
        node = helper.make_node(kind, names, made, name=f"{kind}_{made[0]}", **attributes)
        self._scopes[-1].append(node)
        return out

    def loop(
        self, most: int | Value, state: Sequence[Value], body: Body
    ) -> tuple[list[Value], list[Value]]:
        """Repeat, at least once.

        Parameters
        ----------
        most : int or Value
            Repetitions.
        state : sequence of Value
        body : callable
            Of the number of the repetition and the state; gives whether to go on (None if always),
            the next state, and what is to be kept of each repetition.

        Returns
        -------
        state : list of Value
        kept : list of Value
            Each with a new first axis.
        """
        from onnx import helper

        number, going = self._new(np.int64), self._new(bool)
        inside = [self._new(value.dtype) for value in state]
        self._scopes.append([])
        goes_on, after, kept = body(number, inside)
        ends = [self.apply("Identity", going if goes_on is None else goes_on)]
        ends += [self.apply("Identity", value) for value in (*after, *kept)]
        graph = helper.make_graph(
            self._scopes.pop(),
            f"loop_{number.name}",
            [_declared(number, ()), _declared(going, ()), *map(_declared, inside)],
            [_declared(ends[0], ()), *map(_declared, ends[1:])],
        )
        dtypes = [value.dtype for value in (*after, *kept)]
        trips = most if isinstance(most, Value) else self.constant(np.int64(most))
        out = self.apply_many("Loop", trips, None, *state, dtypes=dtypes, body=graph)
        return out[: len(state)], out[len(state) :]

    def branch(
        self,
        condition: Value,
        then: Callable[[], Sequence[Value]],
        otherwise: Callable[[], Sequence[Value]],
    ) -> list[Value]:
        """What one of two functions gives; only that one is computed."""
        from onnx import helper

        graphs: list[Any] = []
        for made in (then, otherwise):
            self._scopes.append([])
            ends = [self.apply("Identity", value) for value in made()]
            name = f"branch_{ends[0].name}"
            graphs.append(helper.make_graph(self._scopes.pop(), name, [], [*map(_declared, ends)]))
        dtypes = [end.dtype for end in ends]
        return self.apply_many(
            "If", condition, dtypes=dtypes, then_branch=graphs[0], else_branch=graphs[1]
        )

    def input(self, name: str, dtype: DTypeLike) -> Value:
        """An input of the whole graph."""
        return Value(self, name, dtype)

    def to_model(
        self,
        name: str,
        inputs: Sequence[tuple[Value, tuple[int, ...]]],
        outputs: Sequence[tuple[str, Value, tuple[int, ...]]],
        facts: dict[str, str],
    ) -> Any:
        """The graph as an ``onnx.ModelProto``, checked.

        Parameters
        ----------
        name : str
        inputs : sequence of (Value, shape)
        outputs : sequence of (name, Value, shape)
        facts : dict of str
            Kept beside the graph.
        """
        from onnx import checker, helper

        for called, value, _ in outputs:
            node = helper.make_node("Identity", [value.name], [called])
            self._scopes[-1].append(node)
        graph = helper.make_graph(
            [*self._first, *self._scopes[0]],
            name,
            [_declared(value, shape) for value, shape in inputs],
            [_declared(Value(self, called, v.dtype), shape) for called, v, shape in outputs],
            self._initializers,
        )
        opset = [helper.make_opsetid("", OPSET)]
        model = helper.make_model(graph, opset_imports=opset, ir_version=IR_VERSION)
        helper.set_model_props(model, facts)
        checker.check_model(model)
        return model

    def _new(self, dtype: DTypeLike) -> Value:
        self._n_names += 1
        return Value(self, f"v{self._n_names}", dtype)


def where(condition: Value, a: Any, b: Any) -> Value:
    """`a` where the condition is true, and `b` elsewhere; one of them is a Value."""
    typed = a if isinstance(a, Value) else b
    graph = condition.graph
    return graph.apply(
        "Where", condition, graph.like(a, typed), graph.like(b, typed), dtype=typed.dtype
    )


def maximum(a: Value, b: Any) -> Value:
    """The greater of two, each."""
    return a.graph.apply("Max", a, a.graph.like(b, a))


def minimum(a: Value, b: Any) -> Value:
    """The less of two, each."""
    return a.graph.apply("Min", a, a.graph.like(b, a))


def concatenate(parts: Sequence[Any], axis: int = 0) -> Value:
    """Parts one after the other along an axis; one of them is a Value."""
    typed = next(part for part in parts if isinstance(part, Value))
    graph = typed.graph
    return graph.apply(
        "Concat", *(graph.like(part, typed) for part in parts), axis=axis, dtype=typed.dtype
    )


def stack(parts: Sequence[Any], *shape: int) -> Value:
    """Scalars, or vectors of one length, as an array of a shape; one of them is a Value."""
    flat = [part.reshape(-1) if isinstance(part, Value) else [part] for part in parts]
    return concatenate(flat).reshape(*shape)


def _declared(value: Value, shape: Sequence[int] | None = None) -> Any:
    from onnx import helper

    to = helper.np_dtype_to_tensor_dtype(value.dtype)
    return helper.make_tensor_value_info(value.name, to, shape)
