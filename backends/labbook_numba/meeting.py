"""Barrier of threads in compiled code, on one counter that all of them see."""

import os

from llvmlite import ir
from numba import types
from numba.core import cgutils

from labbook_numba.lanes import address, intrinsic

INT64 = ir.IntType(64)


@intrinsic
def arrive(typing, meetings):
    """Add an arrival to meetings[0] (int64) atomically; return the number before."""

    def code(context, builder, sig, args):
        counter = address(context, builder, sig.args[0], args[0], INT64(0), INT64)
        # sequentially consistent: stores before an arrival are visible to those who read the counter
        return builder.atomic_rmw("add", counter, INT64(1), "seq_cst")

    return types.int64(meetings), code


@intrinsic
def arrived(typing, meetings):
    """Number of arrivals. What a thread wrote before its arrival can be read after this (sequential consistency)."""

    def code(context, builder, sig, args):
        counter = address(context, builder, sig.args[0], args[0], INT64(0), INT64)
        return builder.load_atomic(counter, "seq_cst", 8)

    return types.int64(meetings), code


@intrinsic
def give_way(typing):
    """Yield the processor to another thread, if the system has a call for that."""

    def code(context, builder, sig, args):
        if os.name == "posix":
            kind = ir.FunctionType(ir.IntType(32), [])
            builder.call(cgutils.get_or_insert_function(builder.module, kind, "sched_yield"), [])
        return context.get_dummy_value()

    return types.void(), code
