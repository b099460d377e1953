"""Transposed loads and stores of eight rows at scattered places; see `labbook_numba.lanes`."""

from llvmlite import ir
from numba import types

from labbook_numba.lanes import FOUR, INT32, address, eight, eight_rows, intrinsic


def _shuffle(builder, a, b, picks):
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(INT32, len(picks)), list(picks)))


# selections from two registers: even and odd elements; first and second pair of each four elements
LOW, HIGH = (0, 8, 2, 10, 4, 12, 6, 14), (1, 9, 3, 11, 5, 13, 7, 15)
FIRST, SECOND = (0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15)


def _elements(context, builder, kind, index, start, width):
    """Yield the offsets of the eight rows with numbers index[start:start + 8] in an array of rows of `width`
    elements."""
    llvm = context.get_data_type(kind.dtype)
    first = address(context, builder, kind, index, start, llvm)
    wide = ir.IntType(64)
    for c in range(8):
        number = builder.zext(builder.load(builder.gep(first, [INT32(c)])), wide)
        yield builder.mul(number, width)


@intrinsic
def rows_at(typing, array, index, start, width, column):
    """Load four elements, from `column` on, of the eight rows of `array` with numbers index[start:start + 8].

    width: length of a row, a constant, so that the multiplication costs nothing.
    """

    def code(context, builder, sig, args):
        kind, index_kind = sig.args[:2]
        array, index, start, width, column = args
        fours = []
        for element in _elements(context, builder, index_kind, index, start, width):
            pointer = address(context, builder, kind, array, builder.add(element, column), FOUR)
            fours.append(builder.load(pointer, align=8))
        out = ir.Constant(eight_rows.llvm, ir.Undefined)
        for part in range(4):
            both = _shuffle(builder, fours[part], fours[part + 4], range(8))
            out = builder.insert_value(out, both, part)
        return out

    return eight_rows(array, index, types.uint64, types.uint64, types.uint64), code


@intrinsic
def columns(typing, value):
    """Transpose eight rows: their first, second, third and fourth elements."""

    def code(context, builder, sig, args):
        z = [builder.extract_value(args[0], part) for part in range(4)]
        even = [_shuffle(builder, z[k], z[k + 1], LOW) for k in (0, 2)]
        odd = [_shuffle(builder, z[k], z[k + 1], HIGH) for k in (0, 2)]
        vectors = [_shuffle(builder, a, b, picks) for picks in (FIRST, SECOND) for a, b in (even, odd)]
        return context.make_tuple(builder, sig.return_type, vectors)

    return types.UniTuple(eight, 4)(eight_rows), code


@intrinsic
def rows(typing, x, y, z, spare):
    """Transpose columns into eight rows."""

    def code(context, builder, sig, args):
        x, y, z, spare = args
        low, low_rest = _shuffle(builder, x, y, LOW), _shuffle(builder, z, spare, LOW)
        high, high_rest = _shuffle(builder, x, y, HIGH), _shuffle(builder, z, spare, HIGH)
        # low: x0 y0 x2 y2 x4 y4 x6 y6
        out = ir.Constant(eight_rows.llvm, ir.Undefined)
        halves = ((low, low_rest, FIRST), (high, high_rest, FIRST), (low, low_rest, SECOND), (high, high_rest, SECOND))
        for part, (a, b, picks) in enumerate(halves):
            out = builder.insert_value(out, _shuffle(builder, a, b, picks), part)
        return out

    return eight_rows(eight, eight, eight, eight), code


def _each_row(builder, value):
    for c in range(8):
        both = builder.extract_value(value, c % 4)
        yield _shuffle(builder, both, both, range(4 * (c // 4), 4 * (c // 4) + 4))


def _add(context, builder, kind, array, element, value):
    pointer = address(context, builder, kind, array, element, FOUR)
    builder.store(builder.fadd(builder.load(pointer, align=8), value), pointer, align=8)


@intrinsic
def add_rows(typing, array, index, start, width, column, value):
    """Add eight rows to those of `array` with numbers index[start:start + 8], one after the other: numbers may
    repeat."""

    def code(context, builder, sig, args):
        kind, index_kind = sig.args[:2]
        array, index, start, width, column, value = args
        elements = list(_elements(context, builder, index_kind, index, start, width))
        # in sequence: a grain may be in several of the eight contacts
        for element, row in zip(elements, _each_row(builder, value), strict=True):
            _add(context, builder, kind, array, builder.add(element, column), row)
        return context.get_dummy_value()

    return types.void(array, index, types.uint64, types.uint64, types.uint64, eight_rows), code


@intrinsic
def add_two_rows(typing, array, index, start, width, column, value, column2, value2):
    """Do `add_rows` for two columns at once, with fewer instructions."""

    def code(context, builder, sig, args):
        kind, index_kind = sig.args[:2]
        array, index, start, width, column, value, column2, value2 = args
        elements = list(_elements(context, builder, index_kind, index, start, width))
        both = zip(elements, _each_row(builder, value), _each_row(builder, value2), strict=True)
        for element, row, row2 in both:
            _add(context, builder, kind, array, builder.add(element, column), row)
            _add(context, builder, kind, array, builder.add(element, column2), row2)
        return context.get_dummy_value()

    return types.void(
        array, index, types.uint64, types.uint64, types.uint64, eight_rows, types.uint64, eight_rows
    ), code


@intrinsic
def put_rows(typing, array, index, start, width, column, value):
    """Store eight rows in the four elements from `column` on of the rows index[start:start + 8]; width: as in
    `rows_at`."""

    def code(context, builder, sig, args):
        kind, index_kind = sig.args[:2]
        array, index, start, width, column, value = args
        elements = list(_elements(context, builder, index_kind, index, start, width))
        for element, row in zip(elements, _each_row(builder, value), strict=True):
            pointer = address(context, builder, kind, array, builder.add(element, column), FOUR)
            builder.store(row, pointer, align=8)
        return context.get_dummy_value()

    return types.void(array, index, types.uint64, types.uint64, types.uint64, eight_rows), code
