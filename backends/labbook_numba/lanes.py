"""SIMD values in compiled code: `eight` doubles, the `row` of four that holds a vector, `mask`s of eight bits.

Numba vectorises loops but no indirect access, where a contact code spends its time. With these types a kernel states
the contents of a register: grains are stored as rows of four doubles (x, y, z, spare), loaded at once; `columns`
transposes eight rows into three `eight`s for the laws, and `rows` transposes them back. They are lowered to LLVM's
portable vectors: processors with narrower registers use several.
"""

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic as _intrinsic
from numba.extending import lower_builtin, models, register_model

intrinsic: Any = _intrinsic  # typed as Any: the decorated functions are called without their first argument

DOUBLE, INT32, BIT = ir.DoubleType(), ir.IntType(32), ir.IntType(1)
FOUR, EIGHT, EIGHT_INTS = ir.VectorType(DOUBLE, 4), ir.VectorType(DOUBLE, 8), ir.VectorType(INT32, 8)


class Simd(types.Type):
    """Type of a value that LLVM represents as `llvm`."""

    def __init__(self, name: str, llvm: ir.Type):
        self.llvm = llvm
        super().__init__(name=name)


row = Simd("row", FOUR)
eight = Simd("eight", EIGHT)
mask = Simd("mask", ir.VectorType(BIT, 8))
eight_rows = Simd("eight_rows", ir.ArrayType(EIGHT, 4))
"""Four registers of two rows each: 0 and 4, 1 and 5, 2 and 6, 3 and 7. This order makes `columns` cheapest."""


@register_model(Simd)
class _SimdModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, kind.llvm)


# arithmetic


def _spread(builder, number, vector: ir.VectorType):
    """Vector of equal elements."""
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), number, INT32(0))
    return builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(INT32, vector.count), [0] * vector.count))


def _define(operation, instruction: str) -> None:
    @lower_builtin(operation, row, row)
    @lower_builtin(operation, eight, eight)
    def between(context, builder, sig, args):
        return getattr(builder, instruction)(*args)

    @lower_builtin(operation, row, types.float64)
    @lower_builtin(operation, eight, types.float64)
    def with_number(context, builder, sig, args):
        return getattr(builder, instruction)(args[0], _spread(builder, args[1], sig.args[0].llvm))

    @infer_global(operation)  # pyright: ignore[reportOptionalCall]
    class Template(ConcreteTemplate):
        cases = [  # noqa: RUF012 - Numba's protocol
            *(signature(kind, kind, kind) for kind in (row, eight)),
            *(signature(kind, kind, types.float64) for kind in (row, eight)),
        ]


for _operation, _instruction in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul")):
    _define(_operation, _instruction)


@lower_builtin(operator.sub, eight_rows, eight_rows)
def _less_rows(context, builder, sig, args):
    out = args[0]
    for part in range(4):
        a, b = (builder.extract_value(arg, part) for arg in args)
        out = builder.insert_value(out, builder.fsub(a, b), part)
    return out


@infer_global(operator.sub)  # pyright: ignore[reportOptionalCall]
class _LessRows(ConcreteTemplate):
    cases = [signature(eight_rows, eight_rows, eight_rows)]  # noqa: RUF012 - Numba's protocol


@lower_builtin(operator.neg, eight_rows)
def _minus_rows(context, builder, sig, args):
    out = args[0]
    for part in range(4):
        out = builder.insert_value(out, builder.fneg(builder.extract_value(out, part)), part)
    return out


@infer_global(operator.neg)  # pyright: ignore[reportOptionalCall]
class _MinusRows(ConcreteTemplate):
    cases = [signature(eight_rows, eight_rows)]  # noqa: RUF012 - Numba's protocol


# memory; places are counted in elements of a C-contiguous array


def address(context, builder, kind, array, element, llvm: ir.Type):
    """Pointer of type `llvm` to element `element` of an array."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [element]), llvm.as_pointer())


def size_of(kind) -> int:
    return kind.dtype.bitwidth // 8


@intrinsic
def row_at(typing, array, element):
    """Load four doubles of `array` from `element` on."""

    def code(context, builder, sig, args):
        return builder.load(address(context, builder, sig.args[0], *args, llvm=FOUR), align=8)

    return row(array, types.uint64), code


@intrinsic
def put_row(typing, array, element, value):
    """Store a row in `array` from `element` on."""

    def code(context, builder, sig, args):
        builder.store(args[2], address(context, builder, sig.args[0], *args[:2], llvm=FOUR), align=8)
        return context.get_dummy_value()

    return types.void(array, types.uint64, row), code


@intrinsic
def square(typing, value):
    """Sum of the squares of the first three elements of a row."""

    def code(context, builder, sig, args):
        parts = [builder.extract_element(args[0], INT32(c)) for c in range(3)]
        x, y, z = (builder.fmul(part, part) for part in parts)
        return builder.fadd(builder.fadd(x, y), z)

    return types.float64(row), code


@intrinsic
def put(typing, array, element, value):
    """Store eight numbers in `array` from `element` on, rounded to its type."""

    def code(context, builder, sig, args):
        kind, vector = sig.args[0], args[2]
        llvm = ir.VectorType(context.get_data_type(kind.dtype), 8)
        if llvm != EIGHT:
            vector = builder.fptrunc(vector, llvm)
        builder.store(vector, address(context, builder, kind, *args[:2], llvm=llvm), align=size_of(kind))
        return context.get_dummy_value()

    return types.void(array, types.uint64, eight), code


@intrinsic
def eight_at(typing, array, element):
    """Load eight numbers of `array` from `element` on, in double precision."""

    def code(context, builder, sig, args):
        kind = sig.args[0]
        llvm = ir.VectorType(context.get_data_type(kind.dtype), 8)
        vector = builder.load(address(context, builder, kind, *args, llvm=llvm), align=size_of(kind))
        return vector if llvm == EIGHT else builder.fpext(vector, EIGHT)

    return eight(array, types.uint64), code


@intrinsic
def spread(typing, number):
    """Eight copies of a number."""

    def code(context, builder, sig, args):
        return _spread(builder, args[0], EIGHT)

    return eight(types.float64), code
