"""Who may import whom, and other rules that hold for every file of the package."""

import ast
import functools
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from dataclasses import is_dataclass
from graphlib import TopologicalSorter
from pathlib import Path

import numpy as np
import pytest

import featherstone_gait
from featherstone_gait import core

PACKAGE = Path(featherstone_gait.__file__).parent
ROBOTS = Path(__file__).parents[2] / "robots"
ROOMS = ("compile", "tree", "shapes", "effects", "step", "integrate")  # of core
MODULES = {
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"): path
    for path in PACKAGE.rglob("*.py")
    if PACKAGE / "robots" not in path.parents  # of a wheel, with controllers in plain Python
}


@functools.cache
def tree_of(module):
    """A module, parsed once for all tests."""
    return ast.parse(MODULES[module].read_text("utf-8"))


@functools.cache
def nodes_of(module):
    """All nodes of a module, gathered once for all tests."""
    return [*ast.walk(tree_of(module))]


@functools.cache
def all_imports(module):
    """`imports`, gathered once for all tests."""
    return [*imports(module, nodes_of(module))]


def imports(name, nodes):
    """Full names of all that a module imports in these of its nodes."""
    path = MODULES[name]
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: len(package.split(".")) + 1 - node.level] if node.level else []
            source = ".".join([*parents, *filter(None, [node.module])])
            yield from (f"{source}.{alias.name}" for alias in node.names)


def untyped(tree):
    """All nodes but those that are for type checkers alone."""
    for node in ast.iter_child_nodes(tree):
        if not (isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"):
            yield node
            yield from untyped(node)


def functions(*modules):
    """Module and node of every function of some modules, those inside of functions too."""
    for module in modules:
        yield from ((module, node) for node in nodes_of(module) if isinstance(node, ast.FunctionDef))


def outermost(tree):
    """Public functions of a module and public methods of its public classes."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield from [node] if isinstance(node, ast.FunctionDef) else outermost(node)


def arguments(function):
    """All of them, keyword-only ones too, * and ** as one each."""
    a = function.args
    return [x for x in (*a.posonlyargs, *a.args, a.vararg, *a.kwonlyargs, a.kwarg) if x is not None]


def length(function):
    """Lines of a function without its docstring."""
    first, last = function.lineno, function.end_lineno
    if ast.get_docstring(function, clean=False) is not None:
        first += function.body[0].end_lineno - function.body[0].lineno + 1
    return last - first + 1


def within(name, *packages):
    return any(name == package or name.startswith(package + ".") for package in packages)


def modules_of(part):
    found = [name for name in MODULES if within(name, f"featherstone_gait.{part}")]
    assert found
    return found


def test_core_imports_only_core_and_what_compiles_it():
    allowed = ("featherstone_gait.core", "numpy", "numba", "llvmlite", *sys.stdlib_module_names)
    found = [(module, name) for module in modules_of("core") for name in all_imports(module)]
    assert [(module, name) for module, name in found if not within(name, *allowed)] == []


@pytest.mark.parametrize("room", range(len(ROOMS)), ids=ROOMS)
def test_each_room_of_core_imports_only_those_before_it(room):
    later = [f"featherstone_gait.core.{name}" for name in ROOMS[room + 1 :]]
    found = [(module, name) for module in modules_of(f"core.{ROOMS[room]}") for name in all_imports(module)]
    assert [(module, name) for module, name in found if within(name, *later)] == []


def test_shapes_know_no_trees_but_their_vectors():
    found = [(module, name) for module in modules_of("core.shapes") for name in all_imports(module)]
    of_trees = [(module, name) for module, name in found if within(name, "featherstone_gait.core.tree")]
    assert of_trees
    assert [(m, name) for m, name in of_trees if not within(name, "featherstone_gait.core.tree.spatial")] == []


def test_search_knows_no_physics():
    found = [(module, name) for module in modules_of("search") for name in all_imports(module)]
    known = [(module, name) for module, name in found if within(name, "featherstone_gait", "numba")]
    own = ("featherstone_gait.search", "featherstone_gait.base")
    assert [(module, name) for module, name in known if not within(name, *own)] == []


def test_the_library_knows_neither_the_paper_nor_the_benchmarks_nor_the_command_line():
    outer = [f"featherstone_gait.{room}" for room in ("reproduction", "benchmark", "cli")]
    inner = [name for name in MODULES if not within(name, *outer, "featherstone_gait.__main__")]
    assert [(module, name) for module in inner for name in all_imports(module) if within(name, *outer)] == []


def test_benchmarks_know_nothing_of_the_paper():
    found = [(module, name) for module in modules_of("benchmark") for name in all_imports(module)]
    assert [(module, name) for module, name in found if within(name, "featherstone_gait.reproduction")] == []


def test_imports_make_no_circle():
    """Between files, imports inside functions included; a package does not count as imported by what is in it."""
    graph = {
        name: {x if x in MODULES else x.rpartition(".")[0] for x in imports(name, untyped(tree_of(name)))} & {*MODULES}
        for name in MODULES
    }
    assert any(graph.values())
    TopologicalSorter(graph).prepare()  # raises CycleError, which names a circle


def test_rooms_make_no_circle():
    """Between folders of the package, imports for type checkers included."""
    graph = {}
    for name in MODULES:
        rooms = [x.split(".")[1] for x in all_imports(name) if x.startswith("featherstone_gait.") and room_of(x)]
        graph.setdefault(room_of(name), set()).update({*rooms} - {room_of(name)})
    del graph[""]
    assert len(graph) > 15
    assert {"dynamics", "geometry"} < graph["scene"]
    TopologicalSorter(graph).prepare()  # raises CycleError, which names a circle


def room_of(name):
    """The folder of the package in which a module or a name of it is, "" of the package itself."""
    part = name.split(".")[1] if "." in name else ""
    return part if (PACKAGE / part / "__init__.py").is_file() else ""


# 16 as of `solve_ivp`
ENTRIES = {
    "compile_scene", "simulate", "simulate_batch", "gradient", "gradient_batch", "linearize", "minimize", "crosscheck",
    "crosscheck_policy", "judge",
    "drive", "__init__",
}  # fmt: skip


def test_functions_take_few_arguments():
    many = [(len(arguments(node)), module, node.name) for module, node in functions(*MODULES)]
    assert [each for each in many if each[0] > (17 if each[2] in ENTRIES else 10)] == []  # self is one


def test_functions_are_short():
    assert [(module, node.name) for module, node in functions(*MODULES) if length(node) > 60] == []


def test_few_loose_files():
    assert len([*PACKAGE.glob("*.py")]) <= 3


def test_kernels_say_what_they_do():
    """With units; what the recurring arguments are is said in the package."""
    public = [(module, node) for module in modules_of("core") for node in outermost(tree_of(module))]
    assert [(module, node.name) for module, node in public if not ast.get_docstring(node)] == []


def test_functions_outside_of_core_state_types():
    """Of all arguments but self and cls, and of the result."""
    outside = [module for module in MODULES if not within(module, "featherstone_gait.core")]
    untyped = []
    for module, node in functions(*outside):
        given = arguments(node)
        bare = [x.arg for x in given if x.annotation is None and x.arg not in ("self", "cls")]
        if bare or node.returns is None:
            untyped.append((module, node.name, bare))
    assert untyped == []


def test_only_one_module_puts_files_in_their_places():
    """`files.complete` does, whole or not at all; so does the core, which knows no other room, with compiled code."""
    found = [name for name, path in MODULES.items() if re.search(r"\bos\.(replace|rename)\b", path.read_text("utf-8"))]
    assert found == ["featherstone_gait.base.files", "featherstone_gait.core.compile.store_writer"]


def test_only_core_knows_numba():
    outside = [name for name in MODULES if not within(name, "featherstone_gait.core")]
    found = [(module, name) for module in outside for name in all_imports(module)]
    assert [(module, name) for module, name in found if within(name, "numba", "llvmlite")] == []


def named(module):
    """Names that a module uses, those of Numba's attributes and what it imports of Numba."""
    for node in nodes_of(module):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute) and getattr(node.value, "id", "") in ("numba", "nb"):
            yield node.attr
    yield from (name.rpartition(".")[2] for name in all_imports(module) if within(name, "numba"))


def test_only_jit_compiles():
    """`core/compile/jit.py` holds all options of the compiler; everybody else uses its decorators."""
    compilers = {"jit", "njit", "vectorize", "guvectorize", "cfunc", "stencil", "jitclass"}
    found = {module: compilers.intersection(named(module)) for module in MODULES}
    assert {module for module, names in found.items() if names} == {"featherstone_gait.core.compile.jit"}


def test_fields_of_records_are_not_attributes_of_arrays():
    """Compiled code reads any field; with the JIT off a field named as a method of NumPy's would give the method."""
    names = [info.name for info in pkgutil.walk_packages(core.__path__, core.__name__ + ".")]
    types = [x for name in names for x in vars(importlib.import_module(name)).values() if isinstance(x, np.dtype)]
    fields = {field for record in types for field in record.names or ()}
    assert "parent" in fields
    assert fields & {*dir(np.record), *dir(np.recarray)} == set()


def test_importing_the_package_is_cheap():
    """SciPy and Matplotlib are loaded by those who use them, when they use them."""
    program = "import sys, featherstone_gait; print(*{name.partition('.')[0] for name in sys.modules})"
    command = [sys.executable, "-c", program]
    run = subprocess.run(command, cwd=PACKAGE.parent, capture_output=True, text=True, check=True)
    assert {"scipy", "matplotlib", "mujoco", "pandas"} & set(run.stdout.split()) == set()


@pytest.mark.parametrize("folder", [PACKAGE, ROBOTS], ids=["package", "robots"])
def test_no_file_names_a_place_on_some_machine(folder):
    place = re.compile(r"(?<![\w.])/(home|Users|root|work|tmp|mnt|shared)/|[A-Z]:\\\\")
    texts = [path for path in folder.rglob("*") if path.suffix in (".py", ".toml", ".urdf", ".md")]
    assert texts
    assert [path.name for path in texts if place.search(path.read_text("utf-8"))] == []


def public_names():
    """What the package and its rooms hand out (`__all__`), each once."""
    rooms = [module for module, path in MODULES.items() if path.name == "__init__.py"]
    outer = [f"featherstone_gait.{room}" for room in ("core", "benchmark", "reproduction", "cli")]
    found = {}
    for room in (importlib.import_module(name) for name in rooms if not within(name, *outer)):
        for name in vars(room).get("__all__", ()):
            found.setdefault(id(getattr(room, name)), getattr(room, name))
    return [thing for thing in found.values() if inspect.isfunction(thing) or inspect.isclass(thing)]


def undocumented(thing):
    """Sections that a public name's docstring lacks, and arguments that it does not name."""
    text, lacking = inspect.getdoc(thing) or "", []
    sections = set(re.findall(r"(?m)^(\w+)\n-{3,}$", text))
    if inspect.isclass(thing):
        record = is_dataclass(thing) or hasattr(thing, "_fields")
        return ["Attributes"] if record and not sections & {"Attributes", "Parameters"} else []
    signature = inspect.signature(thing)
    if signature.parameters and "Parameters" not in sections:
        lacking.append("Parameters")
    elif signature.parameters:
        stated = re.findall(r"(?m)^((?:\*{0,2}\w+, )*\*{0,2}\w+)(?= :|$)", text)
        named = {name.strip("* ") for line in stated for name in line.split(",")}
        lacking += [name for name in signature.parameters if name not in named]
    if signature.return_annotation not in (None, "None") and not sections & {"Returns", "Yields"}:
        lacking.append("Returns")
    return lacking


def test_public_names_state_parameters_results_and_attributes():
    """In numpydoc sections; ruff's D rules see to the rest."""
    lacking = {f"{thing.__module__}.{thing.__qualname__}": undocumented(thing) for thing in public_names()}
    assert len(lacking) > 150
    assert {name: sections for name, sections in lacking.items() if sections} == {}
