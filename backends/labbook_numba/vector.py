"""Three-component vectors as Numba value types: `vec3f` (single) and `vec3d` (double), with +, -, *, unary -.

Operators are lowered directly to LLVM instructions: they inline, vectorise and cost no compile time.
"""

import operator

from numba import types
from numba.core import cgutils
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import lower_builtin, make_attribute_wrapper, models, register_model, type_callable


class Vec3Type(types.Type):
    """Type of three floats of type `scalar`."""

    def __init__(self, scalar: types.Float):
        self.scalar = scalar
        super().__init__(name=f"vec3_{scalar}")


single = Vec3Type(types.float32)
double = Vec3Type(types.float64)


@register_model(Vec3Type)
class _Vec3Model(models.StructModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, [(name, kind.scalar) for name in "xyz"])


for _name in "xyz":
    make_attribute_wrapper(Vec3Type, _name, _name)


class vec3f:
    """Constructor of a single-precision vector, in compiled code only."""


class vec3d:
    """Constructor of a double-precision vector, in compiled code only."""


def _define(constructor: type, kind: Vec3Type) -> None:
    scalar = kind.scalar

    @type_callable(constructor)
    def typer_of(context):
        def typer(x, y, z):
            if all(isinstance(a, types.Number) for a in (x, y, z)):
                return kind

        return typer

    @lower_builtin(constructor, types.Number, types.Number, types.Number)
    def construct(context, builder, sig, args):
        vector = cgutils.create_struct_proxy(kind)(context, builder)
        for name, value, argument_type in zip("xyz", args, sig.args, strict=True):
            setattr(vector, name, context.cast(builder, value, argument_type, scalar))
        return vector._getvalue()

    def binary(operation, instruction: str) -> None:
        @lower_builtin(operation, kind, kind)
        def lower(context, builder, sig, args):
            a, b = (cgutils.create_struct_proxy(kind)(context, builder, value=v) for v in args)
            out = cgutils.create_struct_proxy(kind)(context, builder)
            for name in "xyz":
                setattr(out, name, getattr(builder, instruction)(getattr(a, name), getattr(b, name)))
            return out._getvalue()

    binary(operator.add, "fadd")
    binary(operator.sub, "fsub")

    @lower_builtin(operator.mul, kind, scalar)
    def times(context, builder, sig, args):
        a = cgutils.create_struct_proxy(kind)(context, builder, value=args[0])
        out = cgutils.create_struct_proxy(kind)(context, builder)
        for name in "xyz":
            setattr(out, name, builder.fmul(getattr(a, name), args[1]))
        return out._getvalue()

    @lower_builtin(operator.neg, kind)
    def minus(context, builder, sig, args):
        a = cgutils.create_struct_proxy(kind)(context, builder, value=args[0])
        out = cgutils.create_struct_proxy(kind)(context, builder)
        for name in "xyz":
            setattr(out, name, builder.fneg(getattr(a, name)))
        return out._getvalue()


_define(vec3f, single)
_define(vec3d, double)


@infer_global(operator.add)  # pyright: ignore[reportOptionalCall]
class _Add(ConcreteTemplate):
    cases = [signature(v, v, v) for v in (single, double)]  # noqa: RUF012 - Numba's protocol


@infer_global(operator.sub)  # pyright: ignore[reportOptionalCall]
class _Sub(ConcreteTemplate):
    cases = [signature(v, v, v) for v in (single, double)]  # noqa: RUF012 - Numba's protocol


@infer_global(operator.mul)  # pyright: ignore[reportOptionalCall]
class _Mul(ConcreteTemplate):
    cases = [signature(v, v, v.scalar) for v in (single, double)]  # noqa: RUF012 - Numba's protocol


@infer_global(operator.neg)  # pyright: ignore[reportOptionalCall]
class _Neg(ConcreteTemplate):
    cases = [signature(v, v) for v in (single, double)]  # noqa: RUF012 - Numba's protocol
