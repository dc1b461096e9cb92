"""How the work of compiling grows with the size of a scene: counted in calls and bytes, which do not depend on time."""

import cProfile
import itertools
import pstats
import random
import tracemalloc

import numpy as np
import pytest

from featherstone_gait.geometry.body import body
from featherstone_gait.model import Ground, Joint, Link, Model, Tendon
from featherstone_gait.model.pair_contact import PairContact
from featherstone_gait.model.placed import Placed, SceneModel
from featherstone_gait.model.shapes import Shape, Sphere
from featherstone_gait.robot_file import load_robot
from featherstone_gait.robot_file.scene import load_scene
from featherstone_gait.run.start import initial_state
from featherstone_gait.scene import pair_choice
from featherstone_gait.scene.compile import compile_scene
from featherstone_gait.scene.pair_choice import chosen_pairs
from featherstone_gait.scene.solids import parts_of

pytestmark = pytest.mark.nojit
TWICE = 2.3  # n log n of these sizes, with a margin for what does not grow


def grid(n, base):
    """Spheres that touch nothing."""
    return [
        Placed(body(Sphere(0.05), 0.5, f"{base}{k}", base), position=(0.2 * (k % 30), 0.2 * (k // 30), 1.0))
        for k in range(n)
    ]


def with_tendons(n):
    """An arm of two joints with so many limited tendons and springs."""
    inertia = (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3)
    links = [Link("post"), *(Link(name, 0.1, (0.1, 0.0, 0.0), inertia) for name in ("upper", "lower"))]
    joints = [
        Joint("shoulder", "revolute", "post", "upper", axis=(0.0, 1.0, 0.0), lower=-1.0, upper=1.0),
        Joint("elbow", "revolute", "upper", "lower", (0.2, 0.0, 0.0), axis=(0.0, 1.0, 0.0), lower=-1.0, upper=1.0),
    ]
    tendons = [
        Tendon(f"t{k}", (("shoulder", 1.0), ("elbow", 0.01 * (k + 1))), stiffness=1.0, lower=-2.0, upper=2.0)
        for k in range(n)
    ]
    return Model("arm", links, joints, tendons=tendons)


def of_obstacles(n):
    return compile_scene(SceneModel("s", grid(1, "floating"), grid(n, "fixed"), pairs="all"))


def of_balls(n):
    return compile_scene(grid(n, "floating"), ground=Ground())


def of_humanoids(n):
    robot = load_robot("humanoid")
    return compile_scene([Placed(robot, f"h{k}", (2.0 * k, 0.0)) for k in range(n)], "mipsd", Ground())


def of_tendons(n):
    return compile_scene(with_tendons(n))


def of_a_file(n, folder, still):
    """Free balls, or one with obstacles, in MJCF."""
    geom = '<geom size="0.05" pos="{} 0 1"/>'
    free = "<body><freejoint/>" + geom + "</body>"
    many = "".join((geom if still else free).format(0.2 * k + 0.001 * n) for k in range(n))
    path = folder / f"{n}.xml"
    path.write_text(f"<mujoco><worldbody>{many}{free.format(-1.0)}</worldbody></mujoco>")
    return compile_scene(load_scene(path), pairs="all" if still else None)


SCENES = {"obstacles": (of_obstacles, 200), "balls": (of_balls, 60), "humanoids": (of_humanoids, 4)}
SCENES |= {"tendons": (of_tendons, 200)}


def counted(make, n):
    """Calls of Python functions, and the most memory [B]."""
    profile = cProfile.Profile()
    profile.enable()
    initial_state(make(n))
    profile.disable()
    tracemalloc.start()
    initial_state(make(n))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return np.array([pstats.Stats(profile).total_calls, peak])


@pytest.mark.parametrize("kind", SCENES)
def test_work_and_memory_grow_with_the_size(kind):
    make, n = SCENES[kind]
    initial_state(make(n))  # what is imported and cached once
    assert (counted(make, 2 * n) < TWICE * counted(make, n)).all()


@pytest.mark.long
@pytest.mark.parametrize(("still", "n"), [(True, 600), (False, 150)])  # of obstacles more than caches hold
def test_work_and_memory_of_a_file_grow_with_its_size(tmp_path, still, n):
    def make(count):
        return of_a_file(count, tmp_path, still)

    initial_state(make(n - 1))
    assert (counted(make, 2 * n) < TWICE * counted(make, n)).all()


def test_the_mass_matrix_of_many_robots_is_checked_robot_by_robot(monkeypatch):
    """Two slides on one body leave one without mass between them: then postures are tried, of 2 x 2 matrices alone."""
    sizes = []
    eigh = np.linalg.eigh
    monkeypatch.setattr(np.linalg, "eigh", lambda a: sizes.append(len(a)) or eigh(a))
    links = [Link("post"), Link("between"), Link("ball", 1.0, inertia=(1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3))]
    joints = [
        Joint("x", "prismatic", "post", "between", axis=(1.0, 0.0, 0.0), lower=-1.0, upper=1.0),
        Joint("y", "prismatic", "between", "ball", axis=(0.0, 1.0, 0.0), lower=-1.0, upper=1.0),
    ]
    compile_scene([Placed(Model("m", links, joints), f"m{k}", (0.1 * k, 0.0, 1.0)) for k in range(20)])
    assert sizes
    assert max(sizes) == 2


def naive(solids, meeting, excluded):
    """The pairs in the order of two loops, by the rules as they are written down."""
    named = {frozenset((one, two)) for one, two in excluded}
    near, found = {frozenset(pair) for pair in meeting.tolist()}, []
    for (i, a), (j, b) in itertools.combinations(enumerate(solids), 2):
        apart = any(frozenset((x, y)) in named for x in (a.of, a.link) for y in (b.of, b.link))
        on_points = (a.link == "ground" and b.on_points) or (b.link == "ground" and a.on_points)
        possible = (a.moves or b.moves) and a.body != b.body and not on_points and not (a.is_surface and b.is_surface)
        if possible and not apart and (a.tree != b.tree or frozenset((i, j)) in near):
            found.append((i, j))
    return found


def test_pairs_are_those_of_two_loops_in_their_order():
    draw = random.Random(1)
    arm = with_tendons(0)
    links = [link.name for link in arm.links]
    shapes = [Shape(name, Sphere(0.01), (0.1 * k, 0.0, 0.0)) for k, name in enumerate(links * 2)]
    robot = Model("arm", arm.links, arm.joints, shapes=shapes)
    members = [Placed(robot, "one"), *grid(4, "floating"), Placed(robot, "two", (3.0, 0.0, 0.0))]
    scene = compile_scene(SceneModel("s", members, grid(5, "fixed"), Ground(), pairs="all"))
    parts = parts_of(scene.members, scene.obstacles, scene.tree, scene.ground)
    names = [*dict.fromkeys(solid.link for solid in parts.solids)]
    excluded = [(draw.choice(names), draw.choice(names)) for _ in range(12)]
    found = chosen_pairs(parts, PairContact("all"), excluded)
    assert found.tolist() == [list(pair) for pair in naive(parts.solids, parts.meeting, excluded)]
    assert 0 < len(found) < len(chosen_pairs(parts, PairContact("all"), []))


def test_too_many_pairs_are_refused_before_they_are_listed(monkeypatch):
    model = SceneModel("s", grid(20, "floating"), grid(10, "fixed"), pairs="all")
    count = 20 * 19 // 2 + 20 * 10
    monkeypatch.setattr(pair_choice, "MANY_PAIRS", count - 1)
    with pytest.warns(UserWarning, match=rf"pairs: {count} pairs of shapes may touch each other, .* GB .* names"):
        compile_scene(model)
    monkeypatch.setattr(pair_choice, "MOST_PAIRS", count - 1)
    with pytest.raises(ValueError, match=rf"pairs: {count} pairs .* at most {count - 1} are taken: give pairs of"):
        compile_scene(model)
    less = SceneModel("s", model.members, model.obstacles, excluded=[("floating0/body", "fixed0/body")], pairs="all")
    assert len(compile_scene(less).pairs) == count - 1
