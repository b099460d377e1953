"""Compressed stores: masks of eight, and stores of the selected elements only, contiguously.

Processors with AVX-512 have an instruction for that. Those with AVX2 permute by a table of all masks, doubles four at a
time. On others LLVM stores one by one. All variants store the same elements.
"""

from typing import Any

from llvmlite import ir
from numba import types

from labbook_numba.lanes import DOUBLE, EIGHT, EIGHT_INTS, INT32, address, eight, intrinsic, mask, size_of

BYTES, BITS = ir.VectorType(ir.IntType(8), 8), mask.llvm


@intrinsic
def positive(typing, value):
    """Mask of the numbers above zero; NaN is not."""

    def code(context, builder, sig, args):
        return builder.fcmp_ordered(">", args[0], ir.Constant(EIGHT, [0.0] * 8))

    return mask(eight), code


@intrinsic
def first_of(typing, count):
    """Mask of the first `count` of eight, or of all."""

    def code(context, builder, sig, args):
        wide = ir.VectorType(ir.IntType(64), 8)
        top = builder.insert_element(ir.Constant(wide, ir.Undefined), args[0], INT32(0))
        top = builder.shuffle_vector(top, top, ir.Constant(EIGHT_INTS, [0] * 8))
        return builder.icmp_unsigned("<", ir.Constant(wide, list(range(8))), top)

    return mask(types.uint64), code


@intrinsic
def both(typing, first, second):
    """Intersection of two masks."""

    def code(context, builder, sig, args):
        return builder.and_(*args)

    return mask(mask, mask), code


@intrinsic
def how_many(typing, value):
    """Number of selected elements of a mask."""

    def code(context, builder, sig, args):
        bits = builder.ctpop(builder.bitcast(args[0], ir.IntType(8)))
        return builder.zext(bits, ir.IntType(64))

    return types.uint64(mask), code


def _permutes(context) -> bool:
    """True for a processor with AVX2, which permutes, but without AVX-512, which compresses."""
    features = context.codegen().magic_tuple()[2].split(",")
    return "+avx2" in features and "+avx512f" not in features


def _put(context, builder, vector, selected, pointer, align: int) -> None:
    """Store the selected elements at `pointer`; up to eight elements from there on are overwritten."""
    if not _permutes(context):
        kind = "i32" if vector.type == EIGHT_INTS else "f64" if vector.type == EIGHT else "f32"
        signature = ir.FunctionType(vector.type, [vector.type, BITS, vector.type])
        compress = builder.module.declare_intrinsic(f"llvm.experimental.vector.compress.v8{kind}", (), signature)
        undefined = ir.Constant(vector.type, ir.Undefined)
        builder.store(builder.call(compress, [vector, selected, undefined]), pointer, align=align)
        return
    bits = builder.bitcast(selected, ir.IntType(8))
    if vector.type != EIGHT:
        builder.store(_permuted(builder, vector, bits, 8), pointer, align=align)
        return
    low, high = (builder.trunc(builder.lshr(bits, ir.IntType(8)(shift)), ir.IntType(4)) for shift in (0, 4))
    half = ir.VectorType(DOUBLE, 4)
    to = builder.bitcast(pointer, half.as_pointer())
    before = builder.zext(builder.ctpop(low), ir.IntType(64))
    behind = builder.bitcast(
        builder.gep(builder.bitcast(pointer, DOUBLE.as_pointer()), [before], source_etype=DOUBLE), half.as_pointer()
    )
    for part, target, first in ((low, to, 0), (high, behind, 4)):
        lanes = ir.Constant(ir.VectorType(INT32, 4), list(range(first, first + 4)))
        four = builder.shuffle_vector(vector, vector, lanes)
        builder.store(_permuted(builder, four, part, 4), target, align=align)


def _permuted(builder, vector, bits, several: int):
    """Elements of a vector of 256 bits with the selected ones first; several: number of elements."""
    kind = ir.FunctionType(EIGHT_INTS, [EIGHT_INTS, EIGHT_INTS])
    permute = builder.module.declare_intrinsic("llvm.x86.avx2.permd", (), kind)
    index = [ir.IntType(64)(0), builder.zext(bits, ir.IntType(64))]
    table = _table(builder.module, several)
    order = builder.load(builder.gep(table, index, inbounds=True), align=32)
    return builder.bitcast(builder.call(permute, [builder.bitcast(vector, EIGHT_INTS), order]), vector.type)


def _table(module: ir.Module, several: int) -> ir.GlobalVariable:
    """Table of permutations: for every mask of `several` elements the order of the 32-bit words, selected ones
    first."""
    name = f"labbook.squeeze.{several}"
    if name in module.globals:
        return module.globals[name]
    words, rows = 8 // several, []
    for bits in range(2**several):
        selected = [k for k in range(several) if bits >> k & 1]
        order = [words * k + word for k in selected for word in range(words)]
        rows.append(ir.Constant(EIGHT_INTS, order + [0] * (8 - len(order))))
    kind = ir.ArrayType(EIGHT_INTS, len(rows))
    table: Any = ir.GlobalVariable(module, kind, name)
    table.linkage, table.global_constant, table.align = "internal", True, 32
    table.initializer = ir.Constant(kind, rows)
    return table


@intrinsic
def squeeze(typing, array, element, value, selected):
    """Store the selected numbers in `array` from `element` on, rounded to its type; what follows is overwritten."""

    def code(context, builder, sig, args):
        kind, vector = sig.args[0], args[2]
        llvm = ir.VectorType(context.get_data_type(kind.dtype), 8)
        if llvm != EIGHT:
            vector = builder.fptrunc(vector, llvm)
        pointer = address(context, builder, kind, *args[:2], llvm=llvm)
        _put(context, builder, vector, args[3], pointer, size_of(kind))
        return context.get_dummy_value()

    return types.void(array, types.uint64, eight, mask), code


@intrinsic
def squeeze_numbers(typing, array, element, source, start, selected):
    """Store the selected of source[start:start + 8] (int32) in `array` from `element` on; what follows them is
    overwritten."""

    def code(context, builder, sig, args):
        to, element, source, start, selected = args
        vector = builder.load(address(context, builder, sig.args[2], source, start, EIGHT_INTS), align=4)
        pointer = address(context, builder, sig.args[0], to, element, EIGHT_INTS)
        _put(context, builder, vector, selected, pointer, 4)
        return context.get_dummy_value()

    return types.void(array, types.uint64, source, types.uint64, mask), code


@intrinsic
def squeeze_indices(typing, array, element, start, selected):
    """Store the selected of start, ..., start + 7 in `array` (int32) from `element` on; what follows is overwritten."""

    def code(context, builder, sig, args):
        to, element, start, selected = args
        low = builder.trunc(start, INT32)
        vector = builder.insert_element(ir.Constant(EIGHT_INTS, ir.Undefined), low, INT32(0))
        vector = builder.shuffle_vector(vector, vector, ir.Constant(EIGHT_INTS, [0] * 8))
        vector = builder.add(vector, ir.Constant(EIGHT_INTS, list(range(8))))
        pointer = address(context, builder, sig.args[0], to, element, EIGHT_INTS)
        _put(context, builder, vector, selected, pointer, 4)
        return context.get_dummy_value()

    return types.void(array, types.uint64, types.uint64, mask), code


@intrinsic
def exchange(typing, array, element, new, present):
    """Load eight flags (uint8) of `array` from `element` on, as numbers, and replace those of the mask `present` by
    `new`.

    The others are not written: they may belong to another thread.
    """

    def code(context, builder, sig, args):
        array, element, new, present = args
        pointer = address(context, builder, sig.args[0], array, element, BYTES)
        before = builder.load(pointer, align=1)
        flags = builder.zext(new, BYTES)
        all_eight = builder.icmp_unsigned("==", builder.bitcast(present, ir.IntType(8)), ir.IntType(8)(255))
        with builder.if_else(all_eight, likely=True) as (whole, partly):
            with whole:
                builder.store(flags, pointer, align=1)
            with partly:
                kind = ir.FunctionType(ir.VoidType(), [BYTES, pointer.type, ir.IntType(32), BITS])
                store = builder.module.declare_intrinsic("llvm.masked.store.v8i8.p0", (), kind)
                builder.call(store, [flags, pointer, ir.IntType(32)(1), present])
        return builder.uitofp(before, EIGHT)

    return eight(array, types.uint64, mask, mask), code
