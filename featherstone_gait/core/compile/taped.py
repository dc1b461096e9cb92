"""Numbers that note how they came about: the type with which the same kernels give gradients.

A kernel compiled with `Taped` arguments computes what it computes with float64, to the same bits, and writes each
operation on a number that depends on an input onto a tape: which numbers it took, and its derivatives by them.  `sweep`
goes back over the tape and gathers what each entry adds to the derivative of a result (reverse accumulation:
A. Griewank and A. Walther, Evaluating Derivatives, 2008, section 3.2).

A value is a float64 and the address of its entry, 0 of a constant.  The tape lies at a multiple of `SPAN`, so that each
address tells where it begins; its first entry has the address of the next free one, how far that moves, and where the
tape ends; its second has the place of an external function, see `begin_external`.  What depends on no input, or not to
first order, gets no entry.

Arrays of taped numbers are float64 arrays with a last axis of two, value and address; constants that are inputs are
`Varying`, as those that differ by lane.  A branch that a kernel takes by a comparison or by `select` is differentiated
as it was taken.
"""

from __future__ import annotations

import operator

import llvmlite.ir as ir
import numpy as np
from numba import types
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, models, overload, register_model

from . import elementary, lanes
from .jit import INLINE, INNER, inline, kernel
from .lanes import llvm_intrinsic, sqrt
from .optional import viewer
from .varying import varying_viewer

SPAN = 1 << 26  # [bytes] of which a tape begins at a multiple, and which it does not exceed
ENTRY = 32  # [bytes]: two int32, how far the operands' entries are from the first; two derivatives; the adjoint
FIRST, SECOND, ADJOINT = 1, 2, 3  # columns of the derivatives and of the adjoint
EXTERNAL, SIZE = 0, 1  # columns of the second entry: where an external function stands, and how many numbers it takes
ONE = 0x3FF0000000000000  # the bits of 1.0
COLUMNS = 8  # tangents that go on together


class _TapedType(types.Type):
    bitwidth = 128

    def __init__(self):
        super().__init__(name="Taped")

    def can_convert_from(self, typingctx, other):
        return Conversion.promote if isinstance(other, types.Float | types.Integer) else None

    def unify(self, typingctx, other):
        return self if isinstance(other, types.Float | types.Integer) else None


Taped = _TapedType()
_NUMBER, _WORD, _HALF = ir.DoubleType(), ir.IntType(64), ir.IntType(32)
_VALUE = ir.LiteralStructType([_NUMBER, _WORD])


@register_model(_TapedType)
class _TapedModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _VALUE)


def _made(builder, number, address):
    made = builder.insert_value(ir.Constant(_VALUE, ir.Undefined), number, 0)
    return builder.insert_value(made, address, 1)


@lower_cast(types.Float, Taped)
@lower_cast(types.Integer, Taped)
def _cast(context, builder, fromty, toty, value):
    return _made(builder, context.cast(builder, value, fromty, types.float64), ir.Constant(_WORD, 0))


def _helper(builder, name, kinds, build):
    """Return the function `name` of the module; `build` makes it where the module does not have it yet."""
    module = builder.module
    try:
        function = module.get_global(name)
    except KeyError:
        function = ir.Function(module, ir.FunctionType(_VALUE, kinds), name)
        function.linkage = "linkonce_odr"
        function.attributes.add("nounwind")
        function.attributes.add("noinline")
        inner = ir.IRBuilder(function.append_basic_block())
        build(inner, function)
    return function


def _note(builder, function, number, operands, slopes):
    """End a helper: return the number, with a new entry if it depends on an operand."""
    zero = ir.Constant(_WORD, 0)
    whole = operands[0] if len(operands) == 1 else builder.or_(*operands)
    with builder.if_then(builder.icmp_unsigned("==", whole, zero), likely=False):
        builder.ret(_made(builder, number, zero))
    base = builder.and_(whole, ir.Constant(_WORD, -SPAN))
    header = builder.inttoptr(base, ir.PointerType(_WORD))
    next_at, move_at, end_at = (builder.gep(header, [ir.Constant(_HALF, k)]) for k in range(3))
    free, move, end = builder.load(next_at), builder.load(move_at), builder.load(end_at)
    matters = None
    for operand, slope in zip(operands, slopes):
        this = builder.icmp_unsigned("!=", operand, zero)
        this = builder.and_(this, builder.fcmp_unordered("!=", slope, ir.Constant(_NUMBER, 0.0)))
        matters = this if matters is None else builder.or_(matters, this)
    matters = builder.and_(matters, builder.icmp_unsigned("<", free, end))
    entry = builder.inttoptr(free, ir.PointerType(_HALF))
    for k, operand in enumerate((*operands, zero)[:2]):
        far = builder.trunc(builder.and_(operand, ir.Constant(_WORD, SPAN - 1)), _HALF)
        builder.store(far, builder.gep(entry, [ir.Constant(_HALF, k)]))
    numbers = builder.bitcast(entry, ir.PointerType(_NUMBER))
    for k in range(2):
        slope = slopes[k] if k < len(slopes) else ir.Constant(_NUMBER, 0.0)
        builder.store(slope, builder.gep(numbers, [ir.Constant(_HALF, 1 + k)]))
    builder.store(ir.Constant(_NUMBER, 0.0), builder.gep(numbers, [ir.Constant(_HALF, ADJOINT)]))
    moved = builder.select(matters, move, zero)
    builder.store(builder.add(free, moved), next_at)
    own = builder.select(builder.icmp_unsigned("==", moved, zero), zero, free)
    builder.ret(_made(builder, number, own))


def _sum(sign):
    def build(builder, function):
        a, at_a, b, at_b = function.args
        zero, one = ir.Constant(_WORD, 0), ir.Constant(_NUMBER, 1.0)
        number = builder.fadd(a, b) if sign > 0 else builder.fsub(a, b)
        with builder.if_then(builder.icmp_unsigned("==", at_b, zero)):
            builder.ret(_made(builder, number, at_a))
        if sign > 0:
            with builder.if_then(builder.icmp_unsigned("==", at_a, zero)):
                builder.ret(_made(builder, number, at_b))
        _note(builder, function, number, (at_a, at_b), (one, ir.Constant(_NUMBER, float(sign))))

    return build


def _product(builder, function):
    a, at_a, b, at_b = function.args
    _note(builder, function, builder.fmul(a, b), (at_a, at_b), (b, a))


def _quotient(builder, function):
    a, at_a, b, at_b = function.args
    number = builder.fdiv(a, b)
    inverse = builder.fdiv(ir.Constant(_NUMBER, 1.0), b)
    _note(builder, function, number, (at_a, at_b), (inverse, builder.fneg(builder.fmul(number, inverse))))


def _of_one(builder, function):
    number, at, slope = function.args
    _note(builder, function, number, (at,), (slope,))


def _of_two(builder, function):
    number, at_a, slope_a, at_b, slope_b = function.args
    _note(builder, function, number, (at_a, at_b), (slope_a, slope_b))


_BINARY = {"add": _sum(1), "sub": _sum(-1), "mul": _product, "truediv": _quotient}
_PLAIN = {"add": ir.IRBuilder.fadd, "sub": ir.IRBuilder.fsub, "mul": ir.IRBuilder.fmul, "truediv": ir.IRBuilder.fdiv}


def _unpacked(builder, *values):
    return [builder.extract_value(value, k) for value in values for k in range(2)]


def _lower_binary(op, name):
    @infer_global(op)
    class Template(ConcreteTemplate):
        cases = [signature(Taped, Taped, Taped)]  # noqa: RUF012

    @lower_builtin(op, Taped, Taped)
    def lower(context, builder, sig, args):
        a, at_a, b, at_b = parts = _unpacked(builder, *args)
        plain = _made(builder, _PLAIN[name](builder, a, b), ir.Constant(_WORD, 0))
        constant = builder.icmp_unsigned("==", builder.or_(at_a, at_b), ir.Constant(_WORD, 0))
        before = builder.block
        with builder.if_then(builder.not_(constant)):
            noted = builder.call(_helper(builder, f"taped_{name}", [_NUMBER, _WORD] * 2, _BINARY[name]), parts)
            within = builder.block
        result = builder.phi(_VALUE)
        result.add_incoming(plain, before)
        result.add_incoming(noted, within)
        return result


def _lower_comparison(op, sign):
    @infer_global(op)
    class Template(ConcreteTemplate):
        cases = [signature(types.boolean, Taped, Taped)]  # noqa: RUF012

    @lower_builtin(op, Taped, Taped)
    def lower(context, builder, sig, args):
        a, _, b, _ = _unpacked(builder, *args)
        return (builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered)(sign, a, b)


def _lower_unary(op, change):
    @infer_global(op)
    class Template(AbstractTemplate):
        def generic(self, args, kws):
            return signature(Taped, Taped) if args == (Taped,) else None

    @lower_builtin(op, Taped)
    def lower(context, builder, sig, args):
        number, at = _unpacked(builder, args[0])
        return _chained(builder, *change(builder, number, at))


def _chained(builder, number, at, slope):
    return builder.call(_helper(builder, "taped_one", [_NUMBER, _WORD, _NUMBER], _of_one), [number, at, slope])


def _negated(builder, number, at):
    return builder.fneg(number), at, ir.Constant(_NUMBER, -1.0)


def _absolute(builder, number, at):
    negative = builder.fcmp_ordered("<", number, ir.Constant(_NUMBER, 0.0))
    slope = builder.select(negative, ir.Constant(_NUMBER, -1.0), ir.Constant(_NUMBER, 1.0))
    return llvm_intrinsic("fabs")(builder, number), at, slope


for _name in _BINARY:
    for _op in (getattr(operator, _name), getattr(operator, f"i{_name}")):
        _lower_binary(_op, _name)
for _name, _sign in {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}.items():
    _lower_comparison(getattr(operator, _name), _sign)
_lower_unary(operator.neg, _negated)
_lower_unary(abs, _absolute)


def value_of(x):
    """Return the number of a taped value, as a constant; any other value as it is."""
    return x


@intrinsic
def _value_of(typingctx, x):
    return signature(types.float64, x), lambda context, builder, sig, args: builder.extract_value(args[0], 0)


@overload(value_of, jit_options=INLINE)
def _overload_value_of(x):
    return (lambda x: _value_of(x)) if x is Taped else (lambda x: x)


@intrinsic
def on_the_tape(typingctx, x):
    """Return a number as a taped one, a constant if it is none."""
    return Taped(x), lambda context, builder, sig, args: context.cast(builder, args[0], sig.args[0], Taped)


@intrinsic
def entry_of(typingctx, x):
    """Return the address of the entry of a taped value, 0 of a constant."""

    def codegen(context, builder, sig, args):
        return builder.extract_value(args[0], 1)

    return signature(types.int64, x), codegen


@intrinsic
def with_entry(typingctx, number, address):
    """Return a taped value of a number and the address of its entry."""
    return signature(Taped, types.float64, types.int64), lambda context, builder, sig, args: _made(builder, *args)


@intrinsic
def chained(typingctx, x, number, slope):
    """Return the taped value `number` whose derivative by x is `slope`."""

    def codegen(context, builder, sig, args):
        at = builder.extract_value(args[0], 1)
        return _chained(builder, args[1], at, args[2])

    return signature(Taped, Taped, types.float64, types.float64), codegen


@intrinsic
def chained_by_two(typingctx, x, y, number, slope_x, slope_y):
    """Return the taped value `number` with the derivatives by x and y."""

    def codegen(context, builder, sig, args):
        function = _helper(builder, "taped_two", [_NUMBER, _WORD, _NUMBER, _WORD, _NUMBER], _of_two)
        at_x, at_y = (builder.extract_value(value, 1) for value in args[:2])
        return builder.call(function, [args[2], at_x, args[3], at_y, args[4]])

    return signature(Taped, Taped, Taped, types.float64, types.float64, types.float64), codegen


taped_view = lanes.viewing(Taped)


def as_taped(array):
    """View a float64 array (..., 2), C-contiguous, of numbers and addresses of their entries as taped numbers (...)."""
    raise NotImplementedError("taped numbers need compiled kernels: unset NUMBA_DISABLE_JIT")


@overload(as_taped, jit_options=INNER)
def _overloadtaped_view(array):
    if isinstance(array, types.Array) and array.dtype == types.float64 and array.layout == "C":
        return lambda array: taped_view(array)
    return None


@intrinsic
def _in_one_row(typingctx, array):
    view = types.Array(Taped, 1, "C")

    def codegen(context, builder, sig, args):
        source = context.make_array(sig.args[0])(context, builder, args[0])
        stride = context.get_constant(types.intp, Taped.bitwidth // 8)
        return lanes.array_over(context, builder, view, source, [source.nitems], [stride])

    return signature(view, array), codegen


@overload(lanes.flat, jit_options=INNER)
def _flat(array):
    if isinstance(array, types.Array) and array.dtype is Taped and array.layout == "C":
        return lambda array: _in_one_row(array)
    return None


varying_on_tape = varying_viewer(as_taped, Taped, as_taped)
on_tape = viewer(as_taped, varying_on_tape)


@overload(sqrt, jit_options=INLINE)
def _sqrt(x):
    def root(x):
        r = sqrt(value_of(x))
        return chained(x, r, 0.5 / r)

    return root if x is Taped else None


@overload(lanes.gather, jit_options=INLINE)
def _gather(table, index):
    return (lambda table, index: table[int(value_of(index))]) if index is Taped else None


@elementary.sincos.of(Taped)
def _sincos(x):
    s, c = elementary.sincos(value_of(x))
    return chained(x, s, c), chained(x, c, -s)


@elementary.angle.of(Taped)
def _angle(y, x):
    a, b = value_of(y), value_of(x)
    r = a * a + b * b
    return chained_by_two(y, x, elementary.angle(a, b), b / r, -a / r)


@elementary.exp.of(Taped)
def _exp(x):
    e = elementary.exp(value_of(x))
    return chained(x, e, e)


@elementary.log.of(Taped)
def _log(x):
    v = value_of(x)
    return chained(x, elementary.log(v), 1.0 / v)


# ---------------------------------------------------------------------------------------------- the tape


class Tape:
    """Memory for the entries of one pass, which begins at a multiple of `SPAN`.

    entries: how many it holds.  Memory that was never written takes none.
    """

    def __init__(self, entries):
        self._memory = np.empty(SPAN + (entries + 2) * ENTRY, np.uint8)
        start = -self._memory.ctypes.data % SPAN
        self.numbers = self._memory[start : start + (entries + 1) * ENTRY].view(np.float64).reshape(-1, ENTRY // 8)
        self.words, self.links = self.numbers.view(np.int64), self.numbers.view(np.int32)
        self.base = int(self.numbers.ctypes.data)
        self.words[0] = self.base + 2 * ENTRY, ENTRY, self.base + entries * ENTRY, 0
        self.words[1] = 0

    @property
    def first(self):
        """The next free entry."""
        return int(self.words[0, 0] - self.base) // ENTRY

    def inputs(self, memory):
        """Give each number of taped memory (..., 2) an entry as an input; return where these begin."""
        first, shape = self.first, memory.shape[:-1]
        count = int(np.prod(shape))
        memory.view(np.int64)[..., 1] = self.base + ENTRY * np.arange(first, first + count).reshape(shape)
        self.words[first : first + count] = 0
        self.words[0, 0] += count * ENTRY
        return first


@inline
def place_of(address):
    """Return which entry is at an address, 0 of a constant."""
    return (address & (SPAN - 1)) // ENTRY


@inline
def used(words):
    """Return how many entries are in use."""
    return place_of(words[0, 0])


@inline
def begin(words, first):
    """Forget all entries from `first` on, and note what comes."""
    base = words[0, 2] & -SPAN
    words[0, 0] = base + first * ENTRY
    words[0, 1] = ENTRY
    words[1, EXTERNAL] = 0


@inline
def as_input(words, number):
    """Return a number as an input, with an entry of its own."""
    address = words[0, 0]
    at = place_of(address)
    for k in range(ENTRY // 8):
        words[at, k] = 0
    words[0, 0] = address + ENTRY
    return with_entry(number, address)


@inline
def input_at(words, entry, number):
    """Return a number that is the input of an entry."""
    return with_entry(number, (words[0, 2] & -SPAN) + entry * ENTRY)


@inline
def add_adjoint(numbers, x, weight):
    """Add to the adjoint of a taped number, if it depends on an input."""
    numbers[place_of(entry_of(x)), ADJOINT] += weight


@kernel
def sweep(numbers, links, first, end):
    """Gather adjoints from the entry before `end` back to `first`; an input has its derivative then."""
    for k in range(end - first):
        at = end - 1 - k
        weight = numbers[at, ADJOINT]
        if weight != 0.0:
            numbers[links[at, 0] // ENTRY, ADJOINT] += numbers[at, FIRST] * weight
            numbers[links[at, 1] // ENTRY, ADJOINT] += numbers[at, SECOND] * weight


@kernel
def push_on(numbers, links, first, end, directions):
    """Fill the tangents (entries, COLUMNS) of the entries from `first` to before `end` from those before."""
    for at in range(first, end):
        a, b = links[at, 0] // ENTRY, links[at, 1] // ENTRY
        by_a, by_b = numbers[at, FIRST], numbers[at, SECOND]
        for c in range(COLUMNS):
            directions[at, c] = by_a * directions[a, c] + by_b * directions[b, c]


@intrinsic
def _peek(typingctx, address, k):
    """Return the word k of an entry."""

    def codegen(context, builder, sig, args):
        return builder.load(builder.gep(builder.inttoptr(args[0], ir.PointerType(_WORD)), [args[1]]))

    return signature(types.int64, types.int64, types.int64), codegen


@intrinsic
def _poke(typingctx, address, k, word):
    """Write the word k of an entry."""

    def codegen(context, builder, sig, args):
        builder.store(args[2], builder.gep(builder.inttoptr(args[0], ir.PointerType(_WORD)), [args[1]]))
        return context.get_dummy_value()

    return signature(types.none, types.int64, types.int64, types.int64), codegen


@inline
def tape_of(array):
    """Return the address of the tape on which numbers of the array are, 0 of constants alone."""
    for i in range(len(array)):
        if entry_of(array[i]) != 0:
            return entry_of(array[i]) & -SPAN
    return 0


@inline
def begin_external(tape, count):
    """Reserve entries for `count` arguments of an external function, which `pass_external` fills, and for its results.

    Its operations are not on the tape: a sweep stops at this entry, and its caller computes the adjoints of the
    arguments.
    """
    at = _peek(tape, 0)
    if at + 2 * count * ENTRY <= _peek(tape, 2):
        _poke(tape, 0, at + 2 * count * ENTRY)
        _poke(tape + ENTRY, EXTERNAL, at)
        _poke(tape + ENTRY, SIZE, count)
    else:
        _poke(tape, 0, _peek(tape, 2))
    return at


@inline
def pass_external(tape, at, count, k, x, number):
    """Make x argument k of an external function, and return its result k, of this value."""
    if at + 2 * count * ENTRY > _peek(tape, 2):
        return with_entry(number, 0)
    entry, after = at + k * ENTRY, at + (count + k) * ENTRY
    for word in range(ENTRY // 8):
        _poke(entry, word, 0)
        _poke(after, word, 0)
    _poke(entry, 0, entry_of(x) & (SPAN - 1))
    _poke(entry, FIRST, ONE)
    return with_entry(number, after)


def constant(x):
    """Return a number without what it depends on."""
    return x


@overload(constant, jit_options=INLINE)
def _constant(x):
    return (lambda x: with_entry(value_of(x), 0)) if x is Taped else (lambda x: x)


def noting(array):
    """Return True for an array of taped numbers, None for any other."""
    return None


@overload(noting, jit_options=INNER)
def _noting(array):
    return (lambda array: True) if array.dtype is Taped else (lambda array: None)


def unless_noted(array, x):
    """Return x, None for an array of taped numbers."""
    return x


@overload(unless_noted, jit_options=INNER)
def _unless_noted(array, x):
    return (lambda array, x: None) if array.dtype is Taped else (lambda array, x: x)
