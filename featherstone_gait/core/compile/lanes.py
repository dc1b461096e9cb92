"""Eight float64 as one value: the SIMD type that lets one kernel source serve one scene or eight.

A kernel is written for scalars.  Compiled with `float64` arguments it steps one scene; compiled with `Lanes` it steps
eight, each operation one vector instruction.  Arrays of lanes are float64 arrays whose last axis has length `WIDTH`
and whose data is aligned to 64 bytes (`aligned`); `as_lanes` views them with one dimension less.

Rules for kernels: no branch on a simulated value (`select`, `any_lane`), no allocation, no libm.  Numba does not
vectorise a loop over copies by itself, since array arguments carry no `noalias`; hence the explicit type, built with
Numba's public extension API (https://numba.readthedocs.io/en/stable/extending/).

With the JIT off the same source runs on NumPy: a lane value is an array of length `WIDTH`.
"""

from __future__ import annotations

import functools
import operator

import llvmlite.ir as ir
import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, models, overload, register_model

from .jit import INLINE, INNER, inline

WIDTH = 8


class _EightType(types.Type):
    """The Numba type of eight values; a plain one, of the types `plain`, converts to it by being repeated."""

    bitwidth = 64 * WIDTH

    def __init__(self, name, *plain):
        self.plain = plain
        super().__init__(name=name)

    def can_convert_from(self, typingctx, other):
        return Conversion.promote if isinstance(other, self.plain) else None

    def unify(self, typingctx, other):
        return self if isinstance(other, self.plain) else None


Lanes = _EightType("Lanes8", types.Float, types.Integer)
Mask = _EightType("Mask8", types.Boolean)
_VECTOR = ir.VectorType(ir.DoubleType(), WIDTH)
_BITS = ir.VectorType(ir.IntType(1), WIDTH)
_INTEGERS = ir.VectorType(ir.IntType(64), WIDTH)


@register_model(_EightType)
class _EightModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _VECTOR if fe_type == Lanes else _BITS)


def _splat(builder, scalar, vector=_VECTOR):
    """Return the vector with `scalar` in every lane."""
    undefined = ir.Constant(vector, ir.Undefined)
    one = builder.insert_element(undefined, scalar, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, undefined, ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH))


@lower_cast(types.Float, Lanes)
@lower_cast(types.Integer, Lanes)
def _cast_number(context, builder, fromty, toty, value):
    return _splat(builder, context.cast(builder, value, fromty, types.float64))


@lower_cast(types.Boolean, Mask)
def _cast_truth(context, builder, fromty, toty, value):
    return _splat(builder, builder.trunc(value, ir.IntType(1)) if value.type.width > 1 else value, _BITS)


def _binary(op, build, result=Lanes, operand=Lanes):
    @infer_global(op)
    class Template(ConcreteTemplate):
        cases = [signature(result, operand, operand)]  # noqa: RUF012

    @lower_builtin(op, operand, operand)
    def lower(context, builder, sig, args):
        return build(builder, *args)


def _unary(op, build, operand=Lanes):
    @infer_global(op)
    class Template(AbstractTemplate):
        def generic(self, args, kws):
            return signature(operand, operand) if args == (operand,) else None

    @lower_builtin(op, operand)
    def lower(context, builder, sig, args):
        return build(builder, args[0])


def llvm_intrinsic(name):
    """Return a builder of calls of the LLVM intrinsic `name` on a vector or a number."""

    def build(builder, value):
        kind, whole = value.type, f"llvm.{name}.{'v8f64' if value.type == _VECTOR else 'f64'}"
        function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind]), whole)
        return builder.call(function, [value])

    return build


for _name, _made in {"add": "fadd", "sub": "fsub", "mul": "fmul", "truediv": "fdiv"}.items():
    for _op in (getattr(operator, _name), getattr(operator, f"i{_name}")):
        _binary(_op, getattr(ir.IRBuilder, _made))
for _name, _sign in {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "=="}.items():
    _binary(getattr(operator, _name), lambda builder, a, b, sign=_sign: builder.fcmp_ordered(sign, a, b), result=Mask)
_binary(operator.ne, lambda builder, a, b: builder.fcmp_unordered("!=", a, b), result=Mask)
_binary(operator.and_, ir.IRBuilder.and_, result=Mask, operand=Mask)
_binary(operator.or_, ir.IRBuilder.or_, result=Mask, operand=Mask)
_unary(operator.neg, ir.IRBuilder.fneg)
_unary(operator.invert, ir.IRBuilder.not_, operand=Mask)
_unary(abs, llvm_intrinsic("fabs"))


def select(mask, a, b):
    """Return `a` where `mask` holds, else `b`."""
    if np.ndim(mask) == 0:
        return a if mask else b
    return np.where(mask, a, b).view(LaneValue)


@intrinsic
def _select_lanes(typingctx, mask, a, b):
    def codegen(context, builder, sig, args):
        return builder.select(*args)

    return signature(Lanes, Mask, Lanes, Lanes), codegen


@overload(select, jit_options=INLINE)
def _select(mask, a, b):
    if mask is Mask:
        return lambda mask, a, b: _select_lanes(mask, a, b)
    return lambda mask, a, b: a if mask else b


@inline
def clamp(x, lower, upper):
    """Return x limited to `lower` ... `upper`; NaN stays."""
    return select(x < lower, lower, select(x > upper, upper, x))


@inline
def sign_beyond(x, limit):
    """Return 1 where x > limit, -1 where x < -limit, else 0."""
    return select(x > limit, 1.0 + 0.0 * x, select(x < -limit, -1.0 + 0.0 * x, 0.0 * x))


def any_lane(mask):
    """Return whether `mask` holds in at least one lane."""
    return bool(np.any(mask))


@intrinsic
def _any_mask(typingctx, mask):
    def codegen(context, builder, sig, args):
        bits = builder.bitcast(args[0], ir.IntType(WIDTH))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(WIDTH), 0))

    return signature(types.boolean, Mask), codegen


@overload(any_lane, jit_options=INLINE)
def _any_lane(mask):
    if mask is Mask:
        return lambda mask: _any_mask(mask)
    return lambda mask: mask


def invert(mask):
    """Return where `mask` does not hold."""
    return np.logical_not(mask)


@overload(invert, jit_options=INLINE)
def _invert(mask):
    if mask is Mask:
        return lambda mask: ~mask
    return lambda mask: not mask


def sqrt(x):
    """Return the square root, correctly rounded."""
    return np.sqrt(x)


@intrinsic
def _sqrt(typingctx, x):
    return signature(x, x), lambda context, builder, sig, args: llvm_intrinsic("sqrt")(builder, args[0])


@overload(sqrt, jit_options=INLINE)
def _overload_sqrt(x):
    return (lambda x: _sqrt(x)) if isinstance(x, types.Number | _EightType) else None


def gather(table, index):
    """Return table[index] of a table (n,), shared or by lane, at whole-number indices that differ by lane."""
    at = np.asanyarray(index).astype(np.int64)
    if table.ndim > 1:
        return np.asarray(table)[at, np.arange(WIDTH)].view(LaneValue)
    return table[at].view(LaneValue) if at.ndim else table[int(at)]


@intrinsic
def _gather_lanes(typingctx, table, index):
    def codegen(context, builder, sig, args):
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        at, result = builder.fptosi(args[1], _INTEGERS), ir.Constant(_VECTOR, ir.Undefined)
        if sig.args[0].dtype is Lanes:  # number k of the vector there
            data = builder.bitcast(data, ir.DoubleType().as_pointer())
            at = builder.mul(at, ir.Constant(_INTEGERS, [WIDTH] * WIDTH))
            at = builder.add(at, ir.Constant(_INTEGERS, list(range(WIDTH))))
        for k in range(WIDTH):
            lane = ir.Constant(ir.IntType(32), k)
            value = builder.load(builder.gep(data, [builder.extract_element(at, lane)]))
            result = builder.insert_element(result, value, lane)
        return result

    return signature(Lanes, table, index), codegen


@overload(gather, jit_options=INLINE)
def _gather(table, index):
    if index is Lanes and table.layout == "C":
        return lambda table, index: _gather_lanes(table, index)
    return (lambda table, index: table[int(index)]) if isinstance(index, types.Number) else None


def power_of_two(n):
    """Return 2**n exactly, for whole n in -1022 ... 1023."""
    return np.ldexp(1.0, np.asanyarray(n).astype(np.int64))[()]


def _exponent_parts(kind):
    """Return bias and place of the exponent in a float64, as constants of int64 as wide as the LLVM type `kind`."""
    if kind == _VECTOR:
        return ir.Constant(_INTEGERS, [1023] * WIDTH), ir.Constant(_INTEGERS, [52] * WIDTH)
    return ir.Constant(ir.IntType(64), 1023), ir.Constant(ir.IntType(64), 52)


@intrinsic
def _power_of_two(typingctx, n):
    def codegen(context, builder, sig, args):
        bias, place = _exponent_parts(args[0].type)
        exponent = builder.add(builder.fptosi(args[0], bias.type), bias)
        return builder.bitcast(builder.shl(exponent, place), args[0].type)

    return signature(n, n), codegen


overload(power_of_two, jit_options=INLINE)(lambda n: lambda n: _power_of_two(n))


def exponent(x):
    """Return the n of x = m 2**n, 1 <= m < 2, of a normal x > 0."""
    return np.frexp(x)[1] - 1.0


@intrinsic
def _exponent(typingctx, x):
    def codegen(context, builder, sig, args):
        bias, place = _exponent_parts(args[0].type)
        bits = builder.lshr(builder.bitcast(args[0], bias.type), place)
        return builder.sitofp(builder.sub(bits, bias), args[0].type)

    return signature(x, x), codegen


overload(exponent, jit_options=INLINE)(lambda x: lambda x: _exponent(x))


class LaneValue(np.ndarray):
    """With the JIT off: a value of lanes, which `x += 1` binds anew, as it does a number, and never changes."""

    __iadd__ = np.ndarray.__add__
    __isub__ = np.ndarray.__sub__
    __imul__ = np.ndarray.__mul__
    __itruediv__ = np.ndarray.__truediv__


class LaneArray(np.ndarray):
    """With the JIT off: a lane array whose loads copy, as loads of compiled code do."""

    def __getitem__(self, index):
        item = super().__getitem__(index)
        if item.ndim == 1:
            return item.copy().view(LaneValue)
        return item

    def __setitem__(self, index, value):
        self.view(np.ndarray)[index] = value  # a subclass's own assignment would go through the copy above


def as_lanes(array):
    """View a float64 array (..., WIDTH), C-contiguous and aligned to 64 bytes, as an array of lanes (...)."""
    return array.view(LaneArray)


def array_over(context, builder, kind, source, shape, strides):
    """Return a C-contiguous array of a Numba type over another array's memory, without a reference to it."""
    result, intp = context.make_array(kind)(context, builder), context.get_value_type(types.intp)
    result.data = builder.bitcast(source.data, result.data.type)
    result.shape, result.strides = cgutils.pack_array(builder, shape, intp), cgutils.pack_array(builder, strides, intp)
    result.itemsize = context.get_constant(types.intp, kind.dtype.bitwidth // 8)
    result.nitems = functools.reduce(builder.mul, shape, context.get_constant(types.intp, 1))
    for name in ("meminfo", "parent"):  # it is no owner, in functions that count references either
        setattr(result, name, cgutils.get_null_value(getattr(result, name).type))
    return result._getvalue()


def viewing(kind):
    """Make an intrinsic that views an array of float64 (..., numbers of a value) as one of values of a Numba type."""

    @intrinsic
    def view(typingctx, array):
        seen = types.Array(kind, array.ndim - 1, "C")

        def codegen(context, builder, sig, args):
            source = context.make_array(sig.args[0])(context, builder, args[0])
            shape, strides = (cgutils.unpack_tuple(builder, x)[:-1] for x in (source.shape, source.strides))
            return array_over(context, builder, seen, source, shape, strides)

        return signature(seen, array), codegen

    return view


_as_lanes = viewing(Lanes)


@overload(as_lanes, jit_options=INNER)
def _overload_as_lanes(array):
    if isinstance(array, types.Array) and array.dtype == types.float64 and array.layout == "C":
        return lambda array: _as_lanes(array)
    return None


def aligned(shape) -> np.ndarray:
    """Return a float64 array of zeros whose data starts at a multiple of 64 bytes."""
    size = int(np.prod(shape))
    memory = np.zeros(size + 8)
    start = -(memory.ctypes.data // 8) % 8
    return memory[start : start + size].reshape(shape)


def flat(array):
    """View an array of numbers, C-contiguous, or of lanes as one of float64 (size,), lanes side by side."""
    return np.asarray(array).reshape(-1)


@intrinsic
def _flat(typingctx, array):
    view = types.Array(types.float64, 1, "C")

    def codegen(context, builder, sig, args):
        source = context.make_array(sig.args[0])(context, builder, args[0])
        width = context.get_constant(types.intp, WIDTH if sig.args[0].dtype is Lanes else 1)
        size, stride = builder.mul(source.nitems, width), context.get_constant(types.intp, 8)
        return array_over(context, builder, view, source, [size], [stride])

    return signature(view, array), codegen


@overload(flat, jit_options=INNER)
def _overload_flat(array):
    if isinstance(array, types.Array) and array.layout == "C" and array.dtype in (types.float64, Lanes):
        return lambda array: _flat(array)
    return None


def width_of(array):
    """Return how many numbers a value of the array is: 1, or `WIDTH` of lanes."""
    return WIDTH if isinstance(array, LaneArray) else 1


@overload(width_of, jit_options=INNER)
def _width_of(array):
    width = WIDTH if array.dtype is Lanes else 1
    return lambda array: width
