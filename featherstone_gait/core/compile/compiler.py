"""How Numba compiles the kernels: its own passes, without those that take half of the time and give these nothing.

- References are not counted.  Kernels make no arrays, and those that they are given outlive the call.  (A function that
  Numba compiles as usual may call a kernel, but none that returns an array: it would give back what nobody took.)
- A function that only kernels call is no program: it is optimised where it is linked into an entry, with all the rest,
  and no machine code is made of it alone.
- A kernel that is called with 0 and with 3 is one kernel, of an integer.
- Python's garbage is not collected meanwhile: there is little, among all that a compiler keeps.

`CompilerBase` is Numba's documented way to change its passes.  The libraries of code are internal to it, which is why
pyproject.toml bounds its version.
"""

from __future__ import annotations

import gc

from llvmlite import binding as llvm
from numba import _dynfunc
from numba.core import types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.typed_passes import NopythonTypeInference

from .progress import Progress, current


class Part(JITCodeLibrary):
    """The code of a function that kernels call: to be linked, as it was written."""

    def _optimize_functions(self, module):
        module.data_layout = self._codegen._data_layout

    def finalize(self):
        """End it without the passes and the machine code of a whole."""
        self._finalize_dynamic_globals()
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == llvm.Linkage.external:
                function.linkage = "linkonce_odr"
        self._finalized = True

    def get_pointer_to_function(self, name):
        """Address of a function: there is none."""
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
        """With all that it calls, for functions that are not compiled by this compiler."""
        self._ensure_finalized()
        module = self._final_module.clone()
        for library in _link(self._linking_libraries, module, {self}):
            module.link_in(library._get_module_for_linking(), preserve=True)
        return module


class Whole(JITCodeLibrary):
    """The code of a function that Python calls."""

    def finalize(self):
        """Link all parts, then optimise and make the machine code."""
        self._linking_libraries = _link(self._linking_libraries, self._final_module, set())
        super().finalize()

    def _optimize_final_module(self):
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
    """Of this function alone: no references, and a library of ours."""

    _name = "before_lowering"

    def __init__(self):
        FunctionPass.__init__(self)

    def run_pass(self, state):
        """Change what the state of the compilation holds."""
        if current:
            current[-1].one_more()
        context = state.targetctx
        context.enable_nrt = False
        kind = Part if state.flags.no_cpython_wrapper else Whole
        state.library = kind(context.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        if kind is Part:
            context.get_executable = _no_executable
        return False


def _no_executable(library, fndesc, env):
    """What Numba keeps of a compiled function, without an address."""
    name = fndesc.qualname.rpartition(".")[2]
    return _dynfunc.make_function(fndesc.lookup_module(), name, name, 0, env, (library,))


class Compiler(CompilerBase):
    """Numba's passes, with one before the code is made."""

    def define_pipelines(self):
        """The passes."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_BeforeLowering, NopythonTypeInference)
        passes.finalize()
        return [passes]


def of_any_integer(dispatcher):
    """Let the calls of a kernel with numbers that are known be calls with an integer."""
    template = dispatcher.get_call_template

    def get_call_template(args, kws):
        return template([_plain(x) for x in args], {name: _plain(x) for name, x in kws.items()})

    dispatcher.get_call_template = get_call_template
    return dispatcher


def _plain(kind):
    return types.unliteral(kind) if isinstance(kind, types.IntegerLiteral) else kind


def compile_entry(compile_, name, kept, arguments):
    """Call `compile_`, with its progress shown and Python's collector of garbage at rest."""
    collects, progress = gc.isenabled(), Progress(name, kept)
    current.append(progress)
    gc.disable()
    try:
        return compile_(arguments)
    finally:
        current.remove(progress)
        progress.end()
        if collects:
            gc.enable()
