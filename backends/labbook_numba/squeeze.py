"""Picking out of eight: masks, and writing only the elements that a mask has, side by side."""

from llvmlite import ir
from numba import types

from labbook_numba.lanes import EIGHT, EIGHT_INTS, INT32, address, eight, intrinsic, mask, size_of

BYTES, BITS = ir.VectorType(ir.IntType(8), 8), mask.llvm


@intrinsic
def positive(typing, value):
    """Which of eight numbers are above zero; one that is no number is not."""

    def code(context, builder, sig, args):
        return builder.fcmp_ordered(">", args[0], ir.Constant(EIGHT, [0.0] * 8))

    return mask(eight), code


@intrinsic
def first_of(typing, count):
    """The first `count` of eight, or all."""

    def code(context, builder, sig, args):
        wide = ir.VectorType(ir.IntType(64), 8)
        top = builder.insert_element(ir.Constant(wide, ir.Undefined), args[0], INT32(0))
        top = builder.shuffle_vector(top, top, ir.Constant(EIGHT_INTS, [0] * 8))
        return builder.icmp_unsigned("<", ir.Constant(wide, list(range(8))), top)

    return mask(types.uint64), code


@intrinsic
def both(typing, one, other):
    """What two masks have in common."""

    def code(context, builder, sig, args):
        return builder.and_(*args)

    return mask(mask, mask), code


@intrinsic
def how_many(typing, value):
    """How many elements a mask has."""

    def code(context, builder, sig, args):
        bits = builder.ctpop(builder.bitcast(args[0], ir.IntType(8)))
        return builder.zext(bits, ir.IntType(64))

    return types.uint64(mask), code


def _squeezed(builder, vector, picked):
    """The picked elements first; the rest is left over."""
    name = f"llvm.experimental.vector.compress.v8{'f64' if vector.type == EIGHT else 'i32'}"
    function = builder.module.declare_intrinsic(
        name, (), ir.FunctionType(vector.type, [vector.type, BITS, vector.type])
    )
    return builder.call(function, [vector, picked, ir.Constant(vector.type, ir.Undefined)])


@intrinsic
def squeeze(typing, array, place, value, picked):
    """Write the picked numbers to `array` from `place` on, rounded to its type; what follows them is lost."""

    def code(context, builder, sig, args):
        kind, vector = sig.args[0], _squeezed(builder, args[2], args[3])
        llvm = ir.VectorType(context.get_data_type(kind.dtype), 8)
        if llvm != EIGHT:
            vector = builder.fptrunc(vector, llvm)
        builder.store(vector, address(context, builder, kind, *args[:2], llvm=llvm), align=size_of(kind))
        return context.get_dummy_value()

    return types.void(array, types.uint64, eight, mask), code


@intrinsic
def squeeze_numbers(typing, array, place, source, start, picked):
    """Write the picked of source[start:start + 8] (int32) to `array` from `place` on; what follows them is lost."""

    def code(context, builder, sig, args):
        to, place, source, start, picked = args
        vector = builder.load(address(context, builder, sig.args[2], source, start, EIGHT_INTS), align=4)
        pointer = address(context, builder, sig.args[0], to, place, EIGHT_INTS)
        builder.store(_squeezed(builder, vector, picked), pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.uint64, source, types.uint64, mask), code


@intrinsic
def squeeze_places(typing, array, place, start, picked):
    """Write the picked of start, ..., start + 7 to `array` (int32) from `place` on; what follows them is lost."""

    def code(context, builder, sig, args):
        to, place, start, picked = args
        low = builder.trunc(start, INT32)
        vector = builder.insert_element(ir.Constant(EIGHT_INTS, ir.Undefined), low, INT32(0))
        vector = builder.shuffle_vector(vector, vector, ir.Constant(EIGHT_INTS, [0] * 8))
        vector = builder.add(vector, ir.Constant(EIGHT_INTS, list(range(8))))
        pointer = address(context, builder, sig.args[0], to, place, EIGHT_INTS)
        builder.store(_squeezed(builder, vector, picked), pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.uint64, types.uint64, mask), code


@intrinsic
def exchange(typing, array, place, now, here):
    """Eight flags (uint8) of `array` from `place` on, as numbers; `now` takes the places of those in `here`.

    Others are not written: they may be another thread's.
    """

    def code(context, builder, sig, args):
        array, place, now, here = args
        pointer = address(context, builder, sig.args[0], array, place, BYTES)
        before = builder.load(pointer, align=1)
        flags = builder.zext(now, BYTES)
        all_eight = builder.icmp_unsigned("==", builder.bitcast(here, ir.IntType(8)), ir.IntType(8)(255))
        with builder.if_else(all_eight, likely=True) as (whole, partly):
            with whole:
                builder.store(flags, pointer, align=1)
            with partly:
                kind = ir.FunctionType(ir.VoidType(), [BYTES, pointer.type, ir.IntType(32), BITS])
                store = builder.module.declare_intrinsic("llvm.masked.store.v8i8.p0", (), kind)
                builder.call(store, [flags, pointer, ir.IntType(32)(1), here])
        return builder.uitofp(before, EIGHT)

    return eight(array, types.uint64, mask, mask), code
