"""The private pipeline: Numba's passes without those that take half of the time and give the kernels nothing.

Numba's own pipeline gives the same bits and is as safe; it takes this one's place where a new Numba lacks what is
changed here, or `FEATHERSTONE_GAIT_COMPILER=plain` asks for it (jit.py).  What this one is for (CPU time to a first
result of 0.2 s, and of a step; Numba 0.68.1, a shared EPYC):

                                         private             plain
    arm7, Euler                          3.8 s, 0.75 us      9.2 s, 0.76 us
    humanoid, MIPSD, ground, midpoint    6.0 s, 2.71 us     13.8 s, 2.79 us

- References are not counted.  Kernels make no arrays, and those that they are given outlive the call.  (A function that
  Numba compiles as usual may call a kernel, but none that returns an array: it would give back what nobody took.)
- A function that only kernels call is no program: it is optimized where it is linked into an entry, with all the rest,
  and no machine code is made of it alone.
- A kernel that is called with 0 and with 3 is compiled once, for an integer; one called with True and False as well.
- What comes after `x is None` is left out where x is an argument that is there.  Numba leaves out what comes after
  `x is not None` where it is None, and would compile a step of one tree into scenes of several.
- The hash of a function's options, the size of a type and the signature of an operator on numbers are kept, which Numba
  works out anew at each call.  Passes for what no kernel has (closures, array expressions) are left out.

`CompilerBase` is Numba's documented way to change its passes.  The libraries of code are internal to it.
"""

from __future__ import annotations

import functools
import operator
from contextlib import contextmanager

import llvmlite.ir
from llvmlite import binding as llvm
from numba import _dynfunc
from numba.core import cgutils, ir, typed_passes, types, untyped_passes
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, Flags
from numba.core.compiler_machinery import FunctionPass, PassManager, register_pass
from numba.core.ir_utils import get_definition, guard
from numba.core.lowering import Lower
from numba.core.typed_passes import NopythonTypeInference
from numba.np.arrayobj import load_item, store_item

from .progress import current
from .structure import never_written, size_of


class _Library(JITCodeLibrary):
    """Code that LLVM optimizes after it has been linked, not function by function."""

    apart = False  # True: never merged into what calls it

    def add_ir_module(self, ir_module):
        never_written(ir_module, self.codegen.target_data)
        for function in ir_module.functions if self.apart else ():
            if not function.is_declaration:
                function.attributes.discard("alwaysinline")  # which Numba gives to all that a merged function calls
                function.attributes.add("noinline")
        super().add_ir_module(ir_module)

    def _optimize_functions(self, module):
        module.data_layout = self._codegen._data_layout


class Part(_Library):
    """The code of a function that kernels call: to be linked, as it was written."""

    def finalize(self):
        """End it without the passes and the machine code of a whole."""
        self._finalize_dynamic_globals()
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == llvm.Linkage.external:
                function.linkage = "linkonce_odr"
        self._finalized = True

    def get_pointer_to_function(self, name):
        """Return no address: a part has no machine code."""
        return 0

    def link_into(self, module, linked):
        """Link it and the parts that it calls into the module, callers first; return the other libraries it needs.

        LLVM leaves out what nothing refers to as yet.  linked: the parts that the module already has.
        """
        if self in linked:
            return []
        linked.add(self)
        module.link_in(self._final_module, preserve=True)
        return _link(self._linking_libraries, module, linked)

    def _get_module_for_linking(self):
        """Return the module with all that it calls, for functions compiled by Numba's own pipeline."""
        self._ensure_finalized()
        module = self._final_module.clone()
        for library in _link(self._linking_libraries, module, {self}):
            module.link_in(library._get_module_for_linking(), preserve=True)
        return module


class Whole(_Library):
    """The code of a function that Python calls."""

    before_passes = None  # what `linked` is made by of the module, for store_writer.py

    def finalize(self):
        """Link all parts, then optimize and make the machine code."""
        self._linking_libraries = _link(self._linking_libraries, self._final_module, set())
        super().finalize()

    def _optimize_final_module(self):
        self.linked = self.before_passes and self.before_passes(self._final_module)
        passes, builder = self._codegen._module_pass_manager()
        passes.run(self._final_module, builder)


def _link(libraries, module, linked):
    """Link those libraries into the module that are parts; return the others."""
    others = []
    for library in libraries:
        others.extend(library.link_into(module, linked) if isinstance(library, Part) else [library])
    return list(dict.fromkeys(others))


@register_pass(mutates_CFG=False, analysis_only=True)
class _BeforeLowering(FunctionPass):
    """Turn off reference counts for the function that is compiled, and give it a library of this file."""

    _name = "before_lowering"

    def __init__(self):
        FunctionPass.__init__(self)

    def run_pass(self, state):
        """Change what the state of the compilation holds."""
        context = state.targetctx
        context.enable_nrt = False
        context.get_abi_sizeof = functools.partial(size_of, context.target_data)
        kind = Part if state.flags.no_cpython_wrapper else Whole
        state.library = kind(context.codegen(), state.func_id.func_qualname)
        state.library.apart = hasattr(state.func_id.func, "apart")
        state.library.enable_object_caching()
        if kind is Part:
            context.get_executable = _no_executable
        return False


@register_pass(mutates_CFG=False, analysis_only=False)
class _WhatIsThere(FunctionPass):
    """Decide `x is None` for an argument that is there; Numba's own pass decides it for one that is None alone."""

    _name = "what_is_there"

    def __init__(self):
        FunctionPass.__init__(self)

    def run_pass(self, state):
        """Put constants in the place of comparisons, by which the next pass leaves out what is not reached."""
        code, changed = state.func_ir, False
        for block in code.blocks.values():
            for assign in block.find_insts(ir.Assign):
                test = assign.value
                if isinstance(test, ir.Expr) and test.op == "binop" and test.fn in (operator.is_, operator.is_not):
                    x, none = (guard(get_definition, code, each) for each in (test.lhs, test.rhs))
                    if isinstance(x, ir.Arg) and isinstance(none, ir.Const) and none.value is None:
                        if not isinstance(state.args[x.index], types.NoneType | types.Optional | types.Omitted):
                            assign.value = ir.Const(test.fn is operator.is_not, test.loc)
                            code._definitions[assign.target.name] = [assign.value]
                            changed = True
        return changed


class _Lower(Lower):
    """Lowering in which an item of a contiguous array takes ten instructions; Numba's fifty copy its descriptor."""

    def lower_getitem(self, resty, expr, value, index, signature):
        """Load an item, or do as Numba does."""
        kind, place = self.typeof(value.name), self.typeof(index.name)
        if self._is_item(kind, place) and resty == kind.dtype:
            at = self._address(kind, place, self.loadvar(value.name), self.loadvar(index.name))
            return load_item(self.context, self.builder, kind, at)
        return super().lower_getitem(resty, expr, value, index, signature)

    def lower_setitem(self, target_var, index_var, value_var, signature):
        """Store an item, or do as Numba does."""
        kind, place = self.typeof(target_var.name), self.typeof(index_var.name)
        if not self._is_item(kind, place):
            return super().lower_setitem(target_var, index_var, value_var, signature)
        value, own = self.loadvar(value_var.name), self.typeof(value_var.name)
        value = self.context.cast(self.builder, value, own, kind.dtype)
        at = self._address(kind, place, self.loadvar(target_var.name), self.loadvar(index_var.name))
        return store_item(self.context, self.builder, kind, value, at)

    def _is_item(self, kind, place):
        """Return whether an index of this type is one item of a contiguous array, within bounds unchecked."""
        indices = place.types if isinstance(place, types.BaseTuple) else [place]
        whole = bool(indices) and all(isinstance(i, types.Integer) and i.signed for i in indices)
        contiguous = isinstance(kind, types.Array) and kind.layout == "C" and kind.ndim == len(indices)
        return whole and contiguous and not self.context.enable_boundscheck

    def _address(self, kind, place, array, index):
        """Return the address of an item, of an index below 0 counted from the end."""
        builder, fields = self.builder, self.context.data_model_manager[kind]
        shape = cgutils.unpack_tuple(builder, fields.get(builder, array, "shape"), kind.ndim)
        several = isinstance(place, types.BaseTuple)
        at, zero = None, shape[0].type(0)
        for one, i, size in zip(
            place.types if several else [place], cgutils.unpack_tuple(builder, index) if several else [index], shape
        ):
            i = self.context.cast(builder, i, one, types.intp)
            if not (isinstance(i, llvmlite.ir.Constant) and i.constant >= 0):
                i = builder.select(builder.icmp_signed("<", i, zero), builder.add(i, size), i)
            at = i if at is None else builder.add(builder.mul(at, size), i)
        return builder.gep(fields.get(builder, array, "data"), [at])


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(typed_passes.BaseNativeLowering):
    """Numba's pass with this `Lower`."""

    _name = "lowering"

    @property
    def lowering_class(self):
        return _Lower


PASSES = (  # those of Numba's DefaultPassBuilder that kernels need
    untyped_passes.TranslateByteCode,
    untyped_passes.FixupArgs,
    untyped_passes.IRProcessing,
    _WhatIsThere,
    untyped_passes.DeadBranchPrune,
    untyped_passes.GenericRewrites,
    untyped_passes.ReconstructSSA,
    untyped_passes.DeadBranchPrune,
    NopythonTypeInference,
    typed_passes.PreLowerStripPhis,
    _BeforeLowering,
    _Lowering,
    typed_passes.NoPythonBackend,
)


def _no_executable(library, fndesc, env):
    """Return what Numba keeps of a compiled function, without an address."""
    name = fndesc.qualname.rpartition(".")[2]
    return _dynfunc.make_function(fndesc.lookup_module(), name, name, 0, env, (library,))


class Compiler(CompilerBase):
    """Numba's passes that kernels need, with one before the code is made."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.state.flags = _Flags(self.state.flags)

    def define_pipelines(self):
        """Return the one pipeline, made of `PASSES`."""
        passes = PassManager("kernels")
        for each in PASSES:
            passes.add_pass(each, each._name)
        passes.finalize()
        return [passes]


class _Flags(Flags):
    """Numba's options of a function with a hash that is computed once; Numba needs it at each call that it types."""

    __slots__ = ("known",)

    def __hash__(self):
        if not hasattr(self, "known"):
            self.known = super().__hash__()
        return self.known

    def __eq__(self, other):
        return self is other or self._values == other._values or super().__eq__(other)


def of_any_integer(dispatcher):
    """Let the calls of a kernel with numbers that are known be calls with an integer, or a truth value."""
    template = dispatcher.get_call_template

    def get_call_template(args, kws):
        return template([_plain(x) for x in args], {name: _plain(x) for name, x in kws.items()})

    dispatcher.get_call_template = get_call_template
    return dispatcher


def _plain(kind):
    return types.unliteral(kind) if isinstance(kind, types.IntegerLiteral | types.BooleanLiteral) else kind


@contextmanager
def operators_kept(dispatcher):
    """Keep the signatures of operators on numbers while an entry is compiled."""
    typing = dispatcher.typingctx
    typing.resolve_function_type = functools.partial(_resolve, type(typing).resolve_function_type, typing)
    try:
        yield
    finally:
        if len(current) == 1:
            vars(typing).pop("resolve_function_type", None)


_signatures: dict = {}  # of operators, by them and the types of the numbers
_OPERATORS = {
    getattr(operator, name) for name in "add sub mul truediv floordiv mod neg lt le gt ge eq ne iadd isub imul".split()
}
_NUMBERS = {"float64", "int64", "bool", "Lanes8"}  # names of the types of kernels' numbers


def _resolve(resolve, typing, function, arguments, names):
    """Return the signature of a call, which for an operator on numbers is worked out once and kept."""
    if names or not isinstance(function, types.Function) or function.typing_key not in _OPERATORS:
        return resolve(typing, function, arguments, names)
    numbers = tuple(map(_plain, arguments))
    if not _NUMBERS.issuperset(kind.name for kind in numbers):
        return resolve(typing, function, arguments, names)
    if (function, numbers) not in _signatures:
        _signatures[function, numbers] = resolve(typing, function, numbers, names)
    return _signatures[function, numbers]
