"""Remedies that messages name: what they name exists, and a call that follows one ends without the message.

`remedies.txt` lists the calls.  A line is a call that ends in a message, in the error, in warnings, notes, the message
of a run or on stderr; after `!` is what it says, `...` for anything; after `>` are calls that follow it.
"""

import ast
import contextlib
import functools
import importlib
import inspect
import io
import itertools
import math
import re
import tomllib
import warnings
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from right_calls import arm, box, company, trajectory

import featherstone_gait as fg
from featherstone_gait import cli, envs, identification, search, walking
from featherstone_gait.base import arguments
from featherstone_gait.core.integrate import INTEGRATORS
from featherstone_gait.judge import run as judging
from featherstone_gait.robot_file.scene_toml import TOP
from featherstone_gait.robot_file.settings import SECTIONS
from featherstone_gait.run import sensors
from featherstone_gait.study import read_study
from featherstone_gait.study.settings import SECTIONS as OF_STUDIES
from featherstone_gait.walking import walker

LONG, PACKAGE, ROOT = pytest.mark.long, Path(fg.__file__).parent, Path(__file__).parents[2]

# ------------------------------------------------------------------------------------------ what the calls name

ARM, BOX, COMPANY = arm(), box(), company()
SERVO = ARM.servos["one"]
PD = replace(SERVO, controller=fg.Controller("pd", 10.0, Kd=0.1))
CLAMPED = replace(SERVO, controller=fg.Controller("pd_clamped", 10.0, Kd=0.1, torque_limit=1.5))
PLAY = replace(SERVO, gearbox=fg.Gearbox(254.0, 1e-7, backlash=0.01))
STIFF = replace(PLAY, gearbox=replace(PLAY.gearbox, stiffness=100.0))
SLOWER = replace(SERVO, controller=replace(SERVO.controller, period=0.02))
WRAPPED = replace(PD, controller=replace(PD.controller, wrap=True))
BARE, EULER = replace(ARM, servos={}), {"integrator": "implicit_euler", "timestep": 1e-3}
MIXED, MIXED_PERIODS = (replace(ARM, servos={"one": one, "two": SERVO}) for one in (PD, SLOWER))
TURNING = [replace(joint, type="continuous", lower=-math.inf, upper=math.inf) for joint in ARM.joints]
FIXED = [replace(joint, type="fixed", lower=0.0, upper=0.0) for joint in ARM.joints]
STILL = replace(ARM.joints[0], type="fixed", lower=-math.inf, upper=math.inf)
HEAVY = [replace(link, mass=1.0, inertia=(1e-2, 0.0, 0.0, 1e-2, 0.0, 1e-2)) for link in ARM.links]
OPEN, TIED = (
    replace(BARE, loops=[fg.Loop("rod", "distance", "b", None, (0.1, 0.0, 0.0), distance=d)]) for d in (5.0, 0.3)
)
CORD = fg.Tendon("cord", [("one", 0.02)], controller=fg.Controller("pd", 1.0))
IMMERSED = replace(BOX, immersed=[fg.Immersed("box", fg.Box((0.2, 0.2, 0.1)))])
FIELD, SEEN = fg.HeightField(np.zeros((3, 2)), (1.0, 1.0)), fg.RangeSensor("b", [[1.0, 0.0, 0.0]])
NEWLINE, DRAWN = "\n", '[sampling]\nmethod = "random"\ncount = 4\n'
SAMPLES = "".join(f"{0.01 * k},0,0\n" for k in range(20))
TENS = "".join(f"{10 * k},0,0\n" for k in range(20))
HEADS = "time [s],reference [rad],angle [rad]\n"
HULL = fg.Hull(((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
SLOPED = 'ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="1" ixz="0" iyz="0"'
OF_TYPE = {"universal": {"axis2": (0.0, 1.0, 0.0)}, "screw": {"pitch": 0.01}, "revolute": {"lower": -1.0, "upper": 1.0}}
OF_TYPE["prismatic"] = OF_TYPE["revolute"]
RUN, ZERO = trajectory(BOX), [0.0, 0.0]
HERE = fg.Target("b", (0.1, 0.0, -0.2))
SERVOS = '[servos]\ndefault = "ax12"\n'
POLY = '<equality><joint joint1="a" joint2="b" polycoef="0 1 1 0 0"/></equality>'
SUNK = fg.SceneModel(
    "sunk",
    [fg.Placed(fg.body(fg.Sphere(0.1), 1.0, name), position=(x, 0, 0))
     for name, x in (("one", 0.0), ("two", 0.02), ("three", 1.0))],
)  # fmt: skip
CROWD = fg.SceneModel(
    "crowd", [fg.Placed(fg.body(fg.Box((0.1, 0.1, 0.1)), 1.0, f"box{k}"), position=(0, 0, 0.1 * k)) for k in range(4)]
)
PRESS = fg.SceneModel(
    "press",
    [fg.Placed(fg.body(fg.Box((0.2, 0.2, 0.01)), 0.1, "plate"), position=(0.0, 0.0, 0.005)),
     fg.Placed(fg.body(fg.Box((0.1, 0.1, 0.1)), 300.0, "block"), position=(0.0, 0.0, 0.3))],
    ground=fg.Ground(),
)  # fmt: skip
SCENES = {
    "OVER": lambda: fg.compile_scene(BOX, ground=fg.Ground(), **EULER),
    "DRIVES": lambda: fg.compile_scene(ARM, "rotor", **EULER),
    "LIMP": lambda: fg.compile_scene(ARM, None, **EULER),
    "FREE": lambda: fg.compile_scene(replace(BARE, joints=TURNING)),
    "DRIVEN_BELT": lambda: fg.compile_scene(
        fg.body(fg.Box((0.1, 0.1, 0.1)), 1.0, surface=fg.Surface((1.0, 0.0, 0.0), drive="belt")),
        ground=fg.Ground(),
        **EULER,
    ),
    "CLOSE": lambda: fg.compile_scene(replace(COMPANY, pairs="all"), None, **EULER),
    "WALKER": lambda: fg.compile_scene(
        fg.load_robot("humanoid", locked="simplified"), "mipsd", fg.Ground(), "midpoint", 1e-3
    ),
}


def with_servo(servo):
    return replace(ARM, servos=dict.fromkeys(ARM.joint_names, servo))


def file(name, text):
    Path(name).write_text(text, "utf-8")
    return name


def legged(count):
    """The file of a trunk on four legs of so many hinges, and no contact points."""
    inertia = (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)
    links, joints, shapes = [fg.Link("trunk", 1.0, inertia=inertia)], [], [fg.Shape("trunk", fg.Box((0.3, 0.3, 0.1)))]
    for n, at in enumerate([(-0.1, -0.1), (-0.1, 0.1), (0.1, -0.1), (0.1, 0.1)]):
        names, start = ["trunk", *(f"{n} {k}" for k in range(count))], (*at, -0.1)
        links += [fg.Link(name, 0.1, inertia=inertia) for name in names[1:]]
        for a, b in itertools.pairwise(names):
            joints.append(fg.Joint(b, "revolute", a, b, start, axis=(0.0, 1.0, 0.0), lower=-1.0, upper=1.0))
            start = (0.0, 0.0, -0.1)
        shapes.append(fg.Shape(names[-1], fg.Sphere(0.03)))
    quietly(fg.save_robot, fg.Model("legged", links, joints, "floating", shapes=shapes), "legged.urdf")
    return "legged.urdf"


def with_legs(count, contacts):
    return walking.with_generic_servos(fg.load_robot(legged(count), contacts=contacts), leg=0.2)


def urdf(more="", joint="", inertia='ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"'):
    """The file of two links and a joint."""
    links = f'<link name="a"/><link name="b"><inertial><mass value="1"/><inertia {inertia}/></inertial>{more}</link>'
    ends = '<parent link="a"/><child link="b"/><axis xyz="0 1 0"/>'
    joint = (joint or '<joint name="j" type="continuous">ENDS</joint>').replace("ENDS", ends)
    return file("robot.urdf", f'<robot name="r">{links}{joint}</robot>')


def with_toml(text):
    file("robot.toml", text)
    return urdf()


def toml(more, robots='[[robots]]\nfile = "arm7"\n'):
    """The file of a scene of a robot and a box."""
    place = "position = [1.0, 0.0, 0.5]\n"
    crate = f'[[objects]]\nname = "box"\nshape = "box"\nsize = [0.1, 0.1, 0.1]\nmass = 1.0\n{place}'
    return file("scene.toml", f"{robots}{crate}{more}" if more.startswith("[") else f"{more}\n{robots}{crate}")


def mjcf(options="", actuators="", joints="a"):
    """The file of pendulums."""
    each = (f'<body><joint name="{n}" axis="0 1 0"/><geom size="0.1" pos="0 0 -0.2"/></body>' for n in joints)
    bodies = f"<worldbody>{''.join(each)}</worldbody>"
    return file("robot.xml", f"<mujoco>{options}{bodies}<actuator>{actuators}</actuator></mujoco>")


def recorded(text):
    return file("r_kp20.csv", text)


def quietly(function, *given, **how):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return function(*given, **how)


def with_session(scene, act, **how):
    with fg.Session(scene, **how) as session:
        return act(session)


def command(line):
    """Run a command; fail with what it says on stderr."""
    said = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        try:
            code = cli.main(line.split())
        except SystemExit as end:
            code = end.code
    if code:
        raise ValueError(said.getvalue())


def still(t, state, reference, command, memory):
    command[0, 0] = 0.0


def last(channels):
    by_q = np.zeros(channels["q"].shape)
    by_q[-1, 0] = 1.0
    return float(channels["q"][-1, 0]), {"q": by_q}


def square(x):
    return float(np.sum(np.square(x)))


def closed(figure):
    from matplotlib import pyplot

    pyplot.close(figure)


def drawn(t, state, reference, command, memory):
    command[0, 0] = np.random.rand()  # noqa: NPY002, what is refused


def calls_dynamics(t, state, reference, command, memory):
    command[0, 0] = fg.energy(ARM, ZERO, ZERO)[0].kinetic


def study(more, vary="servo.Kp = [10.0, 20.0]"):
    head = 'experiment = "hold"\nrobot = "humanoid"\n'
    return read_study(file("study.toml", f"{head}{f'[vary]{NEWLINE}{vary}{NEWLINE}' if vary else ''}{more}"))


def begun(env):
    env.reset()
    return env


def bent(cost):
    return lambda x: (1.0, "ok")


def never(cost):
    return lambda x: (math.inf, "fell")


class Names(dict):
    """Hold the names that calls use; a scene is compiled when the first call names it."""

    def __missing__(self, name):
        if name not in SCENES and name not in fg.__all__:
            raise KeyError(name)
        self[name] = value = SCENES[name]() if name in SCENES else getattr(fg, name)
        return value


NAMES = Names(globals())
NAMES.update(judging=judging, envs=envs, identification=identification, search=search, sensors=sensors, walker=walker)


# ------------------------------------------------------------------------------------------ calls, and what they say


def read_cases():
    cases, long = [], False
    for line in Path(__file__).with_name("remedies.txt").read_text("utf-8").splitlines():
        long |= line == "# LONG"
        if line[:2] in ("! ", "> "):
            cases[-1][line[0]].append(line[2:])
        elif line and line[0] != "#":
            cases.append({"call": line, "!": [], ">": [], "marks": [LONG] * long})
    return cases


CASES = read_cases()


def said(code):
    """Kind and text of all that a call says: its error, warnings, notes, and the status and message of its run."""
    told = []
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            answer = eval(code, NAMES)
        except (ValueError, TypeError, OSError, ImportError, RuntimeError, KeyError) as error:
            told.append(("error", str(error)))
        else:
            told += [("note", note) for note in getattr(answer, "notes", ()) or ()]
            if isinstance(answer, fg.Trajectory):
                told.append((str(answer.status), f"{answer.message}; {answer.status.remedy}"))
    return told + [("warning", str(one.message)) for one in warned]


@functools.cache
def message_of(number):
    """Return what a call says, with its remedy, in one line."""
    return " ".join("; ".join(text for _, text in said(CASES[number]["call"])).split())


def like(message):
    return re.compile(re.sub(r"(\\ )?\\\.\\\.\\\.(\\ )?", ".*", re.escape(message)), re.DOTALL)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Calls write files there."""
    monkeypatch.chdir(tmp_path)
    file("log_kp20.csv", HEADS + SAMPLES)


@pytest.mark.parametrize(
    "number", [pytest.param(k, id=f"{k} {case['call'][:60]}", marks=case["marks"]) for k, case in enumerate(CASES)]
)
def test_what_a_message_tells_to_do_helps(number):
    (message,), rights = CASES[number]["!"], CASES[number][">"]
    assert like(message).search(message_of(number)), message_of(number)
    assert rights
    for right in rights:
        for kind, text in said(right):
            assert kind in ("ok", "note", "warning"), f"{right}: {kind}: {text}"
            assert not like(message).search(" ".join(text.split())), f"{right}: {text}"


# ------------------------------------------------------------------------------------------ names that messages name


def text_of(node):
    """The text of a literal, with NUL where something is put in; None for what is none."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return "".join(part.value if isinstance(part, ast.Constant) else "\0" for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        parts = text_of(node.left), text_of(node.right)
        return None if parts == (None, None) else "".join("\0" if part is None else part for part in parts)
    return None


def sentences(tree):
    """Line, text and called function of each sentence that is no docstring; the last if it is an argument."""
    documented = (n for n in ast.walk(tree) if isinstance(n, ast.Module | ast.ClassDef | ast.FunctionDef))
    docs = {id(n.body[0].value) for n in documented if n.body and isinstance(n.body[0], ast.Expr)}
    todo = [(tree, "")]
    while todo:
        node, owner = todo.pop()
        if id(node) in docs:
            continue
        if isinstance(node, ast.JoinedStr):
            todo += [(part.value, "") for part in node.values if isinstance(part, ast.FormattedValue)]
        if (text := text_of(node)) is None:
            called = getattr(node.func, "id", "") if isinstance(node, ast.Call) else ""
            todo += [(child, called) for child in ast.iter_child_nodes(node)]
        elif " " in text.strip() and "\n" not in text and text[0] != "<":
            yield node.lineno, text, owner


NO_MESSAGES = ("benchmark/", "reproduction/", "core/")  # programs and pages that they write, and what is no message
SENTENCES = [
    (f"{path.relative_to(PACKAGE).as_posix()}:{line}", text, owner)
    for path in sorted(PACKAGE.rglob("*.py"))
    if PACKAGE / "robots" not in path.parents and not path.relative_to(PACKAGE).as_posix().startswith(NO_MESSAGES)
    for line, text, owner in sentences(ast.parse(path.read_text("utf-8")))
    if not re.search(r"carray|State\(|rgba|def ", text)  # code that the package writes
]


PUBLIC = (
    "walking search identification envs optimize crosscheck judge study run.sensors run.prepare identification.bench"
)


@functools.cache
def known():
    """All public functions, classes and methods, by name, with their parameters by name."""
    found = {}
    for module in (fg, *(importlib.import_module(f"featherstone_gait.{name}") for name in PUBLIC.split())):
        own = [name for name, thing in vars(module).items() if getattr(thing, "__module__", "") == module.__name__]
        for name in getattr(module, "__all__", own):
            thing = getattr(module, name)
            members = vars(thing).items() if inspect.isclass(thing) else ()
            for which, one in [(name, thing), *((m, getattr(f, "__func__", f)) for m, f in members)]:
                if which[0] != "_" and (inspect.isfunction(one) or inspect.isclass(one)):
                    with contextlib.suppress(ValueError, TypeError):
                        found.setdefault(which, {}).update(inspect.signature(one).parameters)
    return found


def called_in(text):
    """Calls that a message shows."""
    for match in re.finditer(r"(?<![\w.])@?([A-Za-z_][\w.]*)\(", text):
        depth = 0
        for end in range(match.end() - 1, len(text)):
            depth += (text[end] in "([{") - (text[end] in ")]}")
            if not depth:
                break
        yield match[1].rpartition(".")[2], text[match.start() : end + 1].lstrip("@").replace("\0", "_0")


ELSEWHERE = {"float", "help", "replace", "radians"}  # of Python
IN_MARKUP = {"active", "contype", "conaffinity", "meter", "sleep", "charset"}  # attributes of MJCF, URDF and HTML


def test_functions_and_arguments_that_messages_name_exist():
    functions, shown = known(), 0
    arguments_of_any = set().union(*functions.values()) | IN_MARKUP
    for where, text, _ in SENTENCES:
        for name, call in called_in(text):
            assert name in functions or name in ELSEWHERE, (where, call)
            node = ast.parse(call, mode="eval").body
            for inner in (n for n in ast.walk(node) if isinstance(n, ast.Call)):
                takes = functions.get(ast.unparse(inner.func).rpartition(".")[2], {})
                free = not takes or any(one.kind is one.VAR_KEYWORD for one in takes.values())
                assert free or {one.arg for one in inner.keywords} <= {*takes}, (where, call)
            shown += 1
        for name in re.findall(r"(?<![\w<-])([a-z_]\w*)=(?!=)", text):
            assert name in arguments_of_any, (where, name)
    assert shown > 60


def test_commands_options_extras_sections_and_pages_that_messages_name_exist():
    commands = cli._parser()._subparsers._group_actions[0].choices
    options = {flag for command in commands.values() for action in command._actions for flag in action.option_strings}
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    sections = {*SECTIONS, *TOP, *OF_STUDIES, "gearboxes", "vary", "worlds", "sampling", "observation"}
    counts = Counter()
    for where, text, _ in SENTENCES:
        for kind, pattern, names in (
            ("option", r"(?<![\w-])(--[a-z][\w-]*)", options),
            ("command", r"featherstone-gait ([a-z]+)", commands),
            ("extra", r"featherstone-gait\[(\w+)\]", extras),
            ("section", r"\[\[([a-z]+)\]\]|\[([a-z]+)\.[\w.]+\]|(?:in|under|the|no) \[([a-z]+)\]", sections),
        ):
            for found in re.findall(pattern, text):
                name = found if isinstance(found, str) else "".join(found)
                assert name in names, (where, kind, name)
                counts[kind] += 1
        assert all((ROOT / page).exists() for page in re.findall(r"[\w/]+\.md", text)), where
    assert min(counts.values()) > 4, counts


# ------------------------------------------------------------------------------------------ remedies of one mechanism


@pytest.mark.parametrize("check", [arguments.real, arguments.whole])
@pytest.mark.parametrize("wrong", [-1, 12, "text", None, math.nan])
def test_the_bounds_that_a_message_names_are_taken(check, wrong):
    """Both ends of a range that `real` and `whole` name are accepted, for the bounds of all callers."""
    given = ("x", wrong, 2, "give it") if check is arguments.whole else ("x", wrong, 2.0, 7.0, "give it")
    how = {"most": 7} if check is arguments.whole else {}
    with pytest.raises(ValueError, match=r"expected a (whole )?number from") as refused:
        check(*given, **how)
    for end in re.search(r"from (\S+) to (\S+): give it", str(refused.value)).groups():
        assert check("x", float(end), *given[2:], **how) == float(end)


@pytest.mark.parametrize(
    ("call", "right"),
    [
        ("fg.compile_scene(ARM, 'rotor', integrator='x')", "fg.compile_scene(ARM, 'rotor', integrator={})"),
        ("fg.load_robot('armm')", "fg.load_robot({})"),
        ("fg.load_robot('arm7', mimic='x')", "fg.load_robot('arm7', mimic={})"),
        ("fg.load_servo('x')", "fg.load_servo({})"),
        ("fg.Controller('x')", "fg.Controller({}, 1.0)"),
        pytest.param("fg.Session(DRIVES, action='x')", "fg.Session(DRIVES, action={}).close()", marks=LONG),
        pytest.param("fg.Session(LIMP, action='x')", "fg.Session(LIMP, action='torque').close()", marks=LONG),
        ("walking.first_gait(WALKER, states='x')", "repr({})"),
        ("fg.compile_scene(ARM, 'x')", "fg.compile_scene(with_servo(STIFF), {})"),
        ("fg.Joint('j', 'x', 'a', 'b')", "fg.Joint('j', {}, 'a', 'b', **OF_TYPE.get({}, {{}}))"),
    ],
)
def test_each_choice_that_a_message_names_is_taken(call, right):
    (kind, text), *_ = said(call)
    assert kind == "error"
    choices = re.findall(r"'?([\w-]+)'?", re.search(r"(?:expected|use)(?: one of)? (.*?)(?:: |$)", text)[1])
    choices = [repr(word) for word in choices if word not in ("or", "None", "of")]
    assert choices, text
    for choice in choices:
        assert [one for one in said(right.format(*[choice] * 2)) if one[0] == "error"] == [], choice


# Remedies that name an argument, a function, an option, a section or an integrator, and that no call above tries, by
# room.  They need what a test has not: a package that is missing, a full disk, a search of minutes, recordings of a
# bench, a chain of engines; or they name what MJCF, Gazebo and SimTwo call so.
UNTRIED = {
    "analysis": 4, "cli": 9, "crosscheck": 1, "envs": 1, "geometry": 1, "identification": 1, "optimize": 5,
    "robot_file": 15, "run": 11, "scene": 2, "walking": 2,
}  # fmt: skip
BEGINS = re.compile(r"\b(give|use|try|make it|install|call|write|load|compile|pass|name|add|leave|set) ")
WORDS = "|".join([*INTEGRATORS, "rtol", "timestep"])
NAMED = re.compile(rf"\w=(?!=)[^\0 ]|[a-z_]\w*\(|--[a-z]|\[\[|pip install|\b({WORDS})\b")
CHECKS = {name for name, thing in vars(arguments).items() if inspect.isfunction(thing)}  # tried above


@pytest.mark.long
def test_remedies_that_name_code_are_tried(tmp_path, monkeypatch):
    told = []
    for k in range(len(CASES)):
        (tmp_path / str(k)).mkdir()
        monkeypatch.chdir(tmp_path / str(k))
        file("log_kp20.csv", HEADS + SAMPLES)
        told.append(message_of(k))
    untried, text = [], "\n".join(told)
    for where, sentence, owner in SENTENCES:
        begins = BEGINS.search(sentence)
        if begins and owner not in CHECKS and NAMED.search(sentence[begins.start() :]):
            remedy = ".{0,400}?".join(map(re.escape, re.split("[:;] ", sentence)[-1].split("\0")))
            if not re.search(remedy, text):
                untried.append((where, sentence))
    assert Counter(where.partition("/")[0] for where, _ in untried) == UNTRIED, "\n".join(map(str, untried))
