"""NamedTuples that kernels pass by address, whatever they hold.

Numba takes a NamedTuple apart at each call: the context of a step is some six hundred arguments, which must be typed,
written, parsed and put on the stack, of which a function reads three.  `@structure` makes a class whose values are the
address of their fields; a field is read where it is used.  A structure never changes; arguments are marked so for LLVM.

What kernels must not do: keep a structure from one pass of a loop to the next, which makes its successor in the same
place.  With the JIT off a structure is the NamedTuple that it looks like.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import TypeVar

import llvmlite.ir as ir
import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed, lower_builtin, lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate, infer_getattr, make_callable_template
from numba.core.utils import pysignature
from numba.extending import NativeValue, models, register_model, typeof_impl, unbox

T = TypeVar("T")


class _Structure(type):
    """The class of classes that are structures."""


def structure(cls: type[T]) -> type[T]:
    """Make a NamedTuple class one whose values kernels pass by address."""
    made = _Structure(cls.__name__, cls.__bases__, dict(cls.__dict__))
    typeof_impl.register(made)(lambda x, context: StructureType(made, [typeof_impl(field, context) for field in x]))
    return made


def record(**fields) -> np.dtype:
    """Return the dtype of records of these fields: `float`, `int`, or one of these and a number of them."""
    return np.dtype(list(fields.items()), align=True)


def replacing(cls: type, *names: str) -> Callable:
    """Make a function f(x, *values) that returns a copy of the structure x with these fields replaced, for `inline`."""
    fields = ", ".join(name if name in names else f"_x.{name}" for name in cls._fields)  # no field begins so
    scope = {"__name__": cls.__module__, "made": cls}
    exec(f"def with_{'_'.join(names)}(_x, {', '.join(names)}): return made({fields})", scope)
    return scope[f"with_{'_'.join(names)}"]


class StructureType(types.Type):
    """The Numba type of a structure: the class, and the types of the fields."""

    def __init__(self, instance_class, kinds):
        self.instance_class, self.types, self.fields = instance_class, tuple(kinds), instance_class._fields
        whole = ", ".join([instance_class.__module__, instance_class.__qualname__, *map(str, self.types)])
        super().__init__(f"{instance_class.__name__}({hashlib.sha256(whole.encode()).hexdigest()[:16]})")

    @property
    def key(self):
        """Identify the type (nearly always; `__eq__` compares the fields too)."""
        return self.instance_class, self.name

    def __hash__(self):
        return hash(self.name)

    def __eq__(self, other):
        return self is other or (type(other) is StructureType and self.key == other.key and self.types == other.types)


class _StructureClass(types.Callable, types.Opaque):
    """The Numba type of the class itself."""

    def __init__(self, instance_class):
        self.instance_class = instance_class
        super().__init__(f"class({instance_class.__module__}.{instance_class.__qualname__})")

    def get_call_type(self, context, args, kws):
        return None  # by the attribute __call__

    def get_call_signatures(self):
        return (), True

    def get_impl_key(self, sig):
        return type(self)

    @property
    def key(self):
        return self.instance_class


typeof_impl.register(_Structure)(lambda value, context: _StructureClass(value))
register_model(_StructureClass)(models.OpaqueModel)


class _Address(ir.PointerType):
    """The LLVM type of a value: a pointer that prints as one, not as all that it points to."""

    def __init__(self, body):
        super().__init__()
        self.body = body

    def as_pointer(self, addrspace=0):
        made = ir.PointerType(None, addrspace)
        made.pointee = self  # which Numba looks at
        return made


@register_model(StructureType)
class _StructureModel(models.DataModel):
    """A value is the address of its fields; structures within it are part of it."""

    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type)
        self.inner, self.offsets = [dmm[kind] for kind in fe_type.types], None
        self.body = ir.LiteralStructType(
            [m.body if isinstance(m, _StructureModel) else m.get_value_type() for m in self.inner]
        )
        self.address = _Address(self.body)

    def get_value_type(self):
        return self.address

    def get_data_type(self):
        return self.body

    def as_argument(self, builder, value):
        return value

    def as_data(self, builder, value):
        return builder.load(value, typ=self.body)

    def from_data(self, builder, value):
        made = cgutils.alloca_once_value(builder, value)
        made.type = self.address
        return made

    get_return_type, from_argument, as_return, from_return = get_data_type, as_argument, as_data, from_data

    def load_from_data_pointer(self, builder, ptr, align=None):
        return ptr

    def inner_models(self):
        return self.inner

    def get(self, builder, value, k):
        """Load field k."""
        at = self._address(builder, value, k)
        return at if isinstance(self.inner[k], _StructureModel) else builder.load(at, typ=self.body.elements[k])

    def _address(self, builder, value, k):
        """Return the address of field k, by its offset: that by the type would print the whole type at each use."""
        if self.offsets is None:
            self.offsets = _offsets(self.body)
        at = builder.gep(value, [ir.Constant(ir.IntType(64), self.offsets[k])], inbounds=True, source_etype=_BYTE)
        at.type = self.inner[k].address if isinstance(self.inner[k], _StructureModel) else ir.PointerType()
        return at

    def put(self, context, builder, value, k, field):
        """Write field k, once."""
        at = self._address(builder, value, k)
        if isinstance(self.inner[k], _StructureModel):
            size = ir.Constant(ir.IntType(64), context.get_abi_sizeof(self.inner[k].body))
            cgutils.raw_memcpy(builder, at, field, size, 1)
        else:
            builder.store(field, at)


@infer_getattr
class _Fields(AttributeTemplate):
    key = StructureType

    def generic_resolve(self, kind, name):
        return kind.types[kind.fields.index(name)] if name in kind.fields else None


@infer_getattr
class _Constructor(AttributeTemplate):
    key = _StructureClass

    def resolve___call__(self, kind):
        made = kind.instance_class
        pysig = pysignature(made)

        def typer(*args, **kws):
            given = pysig.bind(*args, **kws).args
            left_out = [types.none] * (len(made._fields) - len(given))  # whose default is None
            return StructureType(made, [types.unliteral(x) for x in given] + left_out)

        typer.pysig = pysig
        return types.Function(make_callable_template(self.key, typer))


@lower_getattr_generic(StructureType)
def _field(context, builder, kind, value, name):
    k = kind.fields.index(name)
    return impl_ret_borrowed(context, builder, kind.types[k], context.data_model_manager[kind].get(builder, value, k))


@lower_builtin(_StructureClass, types.VarArg(types.Any))
def _construct(context, builder, sig, args):
    model = context.data_model_manager[sig.return_type]
    made = cgutils.alloca_once(builder, model.body)
    made.type = model.address
    for k, (field, given, kind) in enumerate(zip(args, sig.args, sig.return_type.types)):
        model.put(context, builder, made, k, context.cast(builder, field, given, kind))
    return made


@unbox(StructureType)
def _unbox(kind, obj, c):
    model = c.context.data_model_manager[kind]
    made = cgutils.alloca_once(c.builder, model.body)
    made.type = model.address
    failed, cleanups = cgutils.false_bit, []
    for k, part in enumerate(kind.types):
        native = c.unbox(part, c.pyapi.tuple_getitem(obj, k))
        model.put(c.context, c.builder, made, k, native.value)
        failed = c.builder.or_(failed, native.is_error)
        if native.cleanup is not None:
            cleanups.append(native.cleanup)

    def cleanup():
        for undo in reversed(cleanups):
            undo()

    return NativeValue(made, cleanup=cleanup, is_error=failed)


_BYTE = ir.IntType(8)


def _offsets(kind):
    """Return the offsets of the elements of an LLVM structure [bytes]."""
    from numba.core.registry import cpu_target

    layout = cpu_target.target_context.target_data
    made = kind._get_ll_global_value_type(layout)
    return [layout.get_element_offset(made, k) for k in range(len(kind.elements))]


_sizes: dict = {}  # of types of llvmlite, by their identity: to compare two takes long


def size_of(layout, kind):
    """Return the bytes of an llvmlite type, kept because llvmlite parses a module to tell it; layout: TargetData."""
    if id(kind) not in _sizes:
        _sizes[id(kind)] = kind.get_abi_size(layout), kind
    return _sizes[id(kind)][0]


def never_written(module, layout):
    """Mark for LLVM that no function of the module (of llvmlite.ir) writes into a structure that it is given.

    layout: llvmlite's TargetData.
    """
    for function in module.functions:
        for argument in function.args[2:]:  # after the results
            kind = argument.type
            if isinstance(kind, _Address):
                argument.attributes.dereferenceable = size_of(layout, kind.body)
                argument.add_attribute("noalias")
                argument.add_attribute("captures(none)")
                set.add(argument.attributes, "readonly")  # llvmlite knows fewer attributes than LLVM
