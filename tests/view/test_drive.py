"""A robot that is driven by hand: what the page sends acts, in size and time as said, and is repeated to the bit."""

import json
import signal
import threading
import time
import urllib.error
import urllib.request
from contextlib import contextmanager

import numpy as np
import pytest
from browser import Tab
from pages import data_of

from featherstone_gait import Box, Trajectory, body, cli, compile_scene, drive, load_robot, replay
from featherstone_gait.run.driven import Driven
from featherstone_gait.view.drive import PARTS, RATE, SILENCE, _adding, _keys, _Page

MASS, LIMIT = 2.0, 5.0  # [kg, N]
STILL = {"keys": [], "grab": None}
PULLED = {"run": 0, "body": 0, "point": [0.0, 0.0, 0.0], "target": [9.0, 0.0, 0.0]}


@pytest.fixture(scope="module")
def block():
    """A block that floats in space."""
    model = body(Box((0.3, 0.3, 0.3)), mass=MASS, name="block")
    return compile_scene(model, integrator="rk4", timestep=1e-3, gravity=(0.0, 0.0, 0.0))


@contextmanager
def driving(scene, keys=(), duration=60.0):
    """A page in use: its address, a function that sends, what was held at each tick, and the page."""
    held = []

    def command(keys, seen):
        held.append(keys)
        return driven.at_rest

    driven = Driven(scene, pushable=True, pace=True)
    driven.warm_up()
    with driven.session:
        page = _Page(driven, keys, LIMIT)
        with page.served(0) as url:
            thread = threading.Thread(target=page.run, args=(command, duration))
            thread.start()
            try:
                yield url, lambda n, **more: post(url, {"n": n} | STILL | more), held, page
            finally:
                page.ended.set()
                thread.join()


def post(url, message):
    request = urllib.request.Request(f"{url}input", json.dumps(message).encode(), method="POST")
    try:
        return urllib.request.urlopen(request, timeout=30).status
    except urllib.error.HTTPError as error:
        return error.code


def until(done):
    end = time.monotonic() + 60.0
    while not done():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_pull_is_limited_accelerates_by_force_over_mass_and_ends_when_the_page_is_silent(block):
    with driving(block) as (_, send, _, page):
        assert send(1, grab=PULLED) == 204
        until(lambda: page.driven.seen["base_qd"][0, 0] > 0.3)  # of 1.25 m/s in the time until silence
        until(lambda: page._grab is None)  # no message for SILENCE
        until(lambda: not page.driven._pushed)
    run = page.driven.trajectory()  # no step is taken meanwhile
    force, speed = run["push"][:, 4:], np.diff(run["base_q"][:, 0]) / page.driven.session.tick
    pulled = np.flatnonzero(force[:, 0])
    assert force[pulled] == pytest.approx(np.tile([LIMIT, 0.0, 0.0], (len(pulled), 1)), rel=1e-12)
    first, last = pulled[0], pulled[-1]
    assert np.array_equal(pulled, np.arange(first, last + 1))
    assert last < len(speed) - 1
    steady = np.diff(speed[first:last]) / page.driven.session.tick
    assert steady == pytest.approx(LIMIT / MASS, rel=1e-9)
    again = replay(block, run)
    assert again.final.tobytes() == run.final.tobytes()
    assert all(np.array_equal(again[name], run[name]) for name in run)


def test_a_spring_holds_the_grabbed_point_and_its_damper_brings_it_to_rest(block):
    near = PULLED | {"point": [0.15, 0.0, 0.0], "target": [0.2, 0.0, 0.0]}
    with driving(block) as (_, send, _, page):
        for n in range(200):  # the pointer stays: a page repeats itself
            assert send(n + 1, grab=near) == 204
            done = len(page.driven._commands)
            until(lambda: len(page.driven._commands) > done)  # noqa: B023  # called before the next one
        run = page.driven.trajectory()
    force = run["push"][:, 4]
    stiffness = force[np.flatnonzero(force)[0]] / 0.05
    assert stiffness == pytest.approx(page._stiffness, rel=1e-9)
    assert np.abs(force).max() < LIMIT
    assert np.abs(run["base_q"][:, 0]).max() < 0.11  # a spring swings by twice the way at most


def test_keys_are_held_until_they_are_let_go_or_the_page_is_silent(block):
    with driving(block, ["a", "b"]) as (_, send, held, page):
        send(5, keys=["a"])
        until(lambda: {"a"} in held)
        send(4, keys=["b"])  # came late
        send(6, keys=["a", "b"])
        until(lambda: {"a", "b"} in held)
        send(7)
        until(lambda: not held[-1])
        before = len(held)
        send(8, keys=["b"])
        until(lambda: {"b"} in held[before:])
        until(lambda: not held[-1])
        assert not page.ended.is_set()
        send(9, end=True)
        assert page.ended.is_set()
    assert {"b"} not in held[: held.index({"a", "b"})]
    assert SILENCE > 10.0 / RATE


def test_other_paths_and_other_messages_are_refused(block):
    with driving(block, ["a"]) as (url, send, _, page):
        assert b"omni" not in urllib.request.urlopen(url, timeout=30).read()
        root = url[: url.index("/", 8)]
        assert post(f"{root}/", {"n": 1} | STILL) == 404
        for wrong in (
            {"keys": ["z"]}, {"keys": 3}, {"grab": PULLED | {"run": 7}}, {"grab": PULLED | {"target": [0.0, 1e9, 0.0]}},
            {"grab": {"run": 0}},
        ):  # fmt: skip
            assert send(1, **wrong) == 400, wrong
        assert post(url, {}) == 400
        assert page._number == -1


def test_keys_that_command_nothing_there_is_are_refused(block, tmp_path):
    for keys, what in (({"a": {"x": 1.0}}, "no 'x'"), ({"a": 3}, "keys: a"), ({3: {}}, "key"), (["a"], "keys")):
        with pytest.raises((ValueError, TypeError), match=what):
            drive(block, keys, path=tmp_path / "run", duration=0.01)
    assert list(tmp_path.iterdir()) == []


def test_wrong_keys_and_places_are_refused_before_anything_is_compiled(tmp_path, monkeypatch):
    scene = compile_scene(load_robot("ax12_arm"), "mipsd", integrator="midpoint", timestep=1e-3)
    monkeypatch.setattr("featherstone_gait.view.drive.Driven", None)  # makes the kernels
    with pytest.raises(ValueError, match="no 'elbw' to command; there are elbow"):
        drive(scene, {"a": {"elbw": 1.0}}, path=tmp_path / "run", duration=0.01)
    with pytest.raises(FileNotFoundError, match=f"no folder {tmp_path / 'no'}; make it"):
        drive(scene, path=tmp_path / "no" / "run", duration=0.01)

    def full(dir):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("featherstone_gait.view.drive.TemporaryFile", full)
    with pytest.raises(PermissionError, match=r"cannot be written.*Permission denied.*; give another"):
        drive(scene, path=tmp_path / "run", duration=0.01)
    assert list(tmp_path.iterdir()) == []


def test_a_page_that_is_driven_has_no_parts_of_a_run(block):
    driven = Driven(block, pushable=True)
    with driven.session:
        (one,) = data_of(_Page(driven, [], LIMIT).html.decode())["runs"]
    assert [one[name] for name in PARTS] == [None] * len(PARTS)


def test_what_was_driven_is_stored_also_where_the_command_fails(block, tmp_path, capsys):
    def command(held, seen):
        if len(seen["base_q"]) and counted.append(0) is None and len(counted) > 5:
            raise RuntimeError("enough")
        return []

    counted = []
    with pytest.raises(RuntimeError, match="enough"):
        drive(block, ["a"], command=command, path=tmp_path / "run", port=0)
    assert len(Trajectory.load(tmp_path / "run")["time"]) == 6
    run = drive(block, duration=0.05, path=tmp_path / "run", port=0)
    assert run.end_time == pytest.approx(0.05)
    assert Trajectory.load(tmp_path / "run").info["lost_time"] >= 0.0
    assert "/ for 0.05 s or until Ctrl-C" in capsys.readouterr().out


def test_ctrl_c_ends_the_run_which_is_stored(block, tmp_path):
    def command(held, seen):
        count.append(0)
        if len(count) == 5:
            signal.raise_signal(signal.SIGINT)
        return []

    count = []
    before = signal.getsignal(signal.SIGINT)
    run = drive(block, ["a"], command=command, path=tmp_path / "run", port=0)
    assert len(count) == 5
    assert run.ok
    assert Trajectory.load(tmp_path / "run").end_time == pytest.approx(5 * 0.01)
    assert signal.getsignal(signal.SIGINT) is before


def test_lost_real_time_is_told_and_not_caught_up(block, tmp_path):
    def command(held, seen):
        time.sleep(0.05)  # in a tick of 0.01 s
        return []

    begun = time.monotonic()
    run = drive(block, ["a"], command=command, duration=0.05, path=tmp_path / "run", port=0)
    assert run.info["lost_time"] > 5 * 0.03
    assert time.monotonic() - begun >= run.info["lost_time"] + 0.03  # the ticks take their time all the same


@pytest.mark.long
def test_keys_turn_the_joints_of_an_arm(tmp_path):
    scene = compile_scene(load_robot("ax12_arm"), "mipsd", integrator="midpoint", timestep=1e-3)
    (joint,) = scene.model.joint_names
    driven = Driven(scene, pushable=True, pace=True)
    with driven.session:
        table = _keys(driven.names, {"A": {joint: 0.5}, "d": {joint: -2.0}}, None)
        command = _adding(driven, table)
        assert [*table] == ["a", "d"]
        assert command(frozenset(), {}).tolist() == [0.0]
        assert command(frozenset("ad"), {}).tolist() == [-1.5]
        page = _Page(driven, [*table], LIMIT)
        page.take({"n": 1, "keys": ["a"], "grab": None})
        page.run(command, 0.4)
        assert driven.seen["qd"][0, 0] == pytest.approx(0.5, rel=0.1)


@pytest.mark.long
def test_the_command_drives_and_stores(tmp_path, capsys):
    arguments = ["--key", "a=elbow:0.5", "--push-limit", "0", "--port", "0", "--out", str(tmp_path)]
    assert cli.main(["drive", "ax12_arm", "--duration", "0.05", *arguments]) == 0
    run = Trajectory.load(tmp_path / "ax12_arm_drive")
    assert run["command"].shape == (len(run["time"]), 1)
    assert "page        http://127.0.0.1:" in capsys.readouterr().out


@pytest.mark.parametrize("key", ["a", "a=", "=elbow:1", "a=elbow", "a=elbow:x", "a=:1", "a=elbow:1,"])
def test_keys_of_the_command_that_say_nothing_are_refused(key, capsys):
    assert cli.main(["drive", "ax12_arm", "--key", key]) == 2
    assert "ArrowUp=left_wheel:6" in capsys.readouterr().err


# ---------------------------------------------------------------------------------------------- in a browser

MIDDLE = """(() => { const r = document.querySelector("#views canvas").getBoundingClientRect();
return [r.left + r.width / 2, r.top + r.height / 2]; })()"""
REACH = """(() => ({wide: document.documentElement.scrollWidth - innerWidth,
visible: document.querySelector(".now").getBoundingClientRect().bottom
  <= document.getElementById("controls").getBoundingClientRect().top,
small: [...document.querySelectorAll("#controls button, #controls select")].filter(e => e.offsetParent).filter(e => {
  const r = e.getBoundingClientRect();
  return r.width < 40 || r.height < 40 || r.right > innerWidth || r.bottom > innerHeight + 0.5;
}).map(e => e.textContent)}))()"""


def test_dragging_in_the_page_pulls_the_robot_and_letting_go_ends_it(block, tmp_path):
    with driving(block, ["ArrowUp", "x"]) as (url, _, held, page), Tab(url, tmp_path) as tab:
        x, y = tab.value(MIDDLE)
        tab.mouse("Pressed", x, y)
        for k in range(1, 6):
            tab.mouse("Moved", x + 30 * k, y)
        size = tab.until("viewer.live.force && Math.hypot(...viewer.live.force.slice(3)) > 0.5 && viewer.live.force")
        assert 0.5 < np.linalg.norm(size[3:]) <= LIMIT * (1 + 1e-4)
        until(lambda: np.linalg.norm(page.driven.seen["base_q"][0, :3]) > 0.02)
        tab.mouse("Released", x + 150, y)
        tab.until("viewer.live.force === null")
        until(lambda: not page.driven._pushed)
        tab.mouse("Pressed", x + 0.45 * x, y - 0.45 * y)  # beside it: the view turns
        tab.mouse("Moved", x + 0.45 * x + 20, y - 0.45 * y)
        assert tab.value("viewer.live.grab") is None
        assert tab.value("viewer.view.yaw") != pytest.approx(-1.1)
        tab.mouse("Released", x + 0.45 * x + 20, y - 0.45 * y)
        tab.key("Down", "ArrowUp")
        until(lambda: held[-1] == {"ArrowUp"})
        tab.key("Down", "X")
        until(lambda: held[-1] == {"ArrowUp", "x"})
        tab.key("Up", "ArrowUp")
        until(lambda: held[-1] == {"x"})
        tab.value("window.dispatchEvent(new Event('blur'))")  # the window is no more in front
        until(lambda: not held[-1])
        tab.key("Up", "X")
        tab.key("Down", "ArrowUp")
        until(lambda: held[-1] == {"ArrowUp"})
        tab.call("Page.navigate", url="about:blank")  # the page is left
        until(lambda: not held[-1])
        assert tab.console == []
        run = page.driven.trajectory()
    assert replay(block, run).final.tobytes() == run.final.tobytes()
    assert np.abs(run["push"][:, 4:]).max() > 0.5


@pytest.mark.quick("size0-*")
@pytest.mark.parametrize(("size", "dark"), [((375, 667), True), ((320, 568), False)])
def test_all_is_in_reach_of_fingers_and_the_run_is_ended_in_the_page(block, tmp_path, size, dark):
    with driving(block, ["ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight"]) as (url, _, held, page):
        with Tab(url, tmp_path, size, dark) as tab:
            tab.until(f"{REACH}.visible")
            assert tab.value(REACH) == {"visible": True, "wide": 0, "small": []}
            down = "document.querySelector('[data-key=ArrowLeft]')"
            at = tab.value(f"(r => [r.left + 9, r.top + 9])({down}.getBoundingClientRect())")
            tab.mouse("Pressed", *at)
            until(lambda: held[-1] == {"ArrowLeft"})
            assert tab.value(f"{down}.getAttribute('aria-pressed')") == "true"
            tab.mouse("Released", *at)
            until(lambda: not held[-1])
            tab.value("[...document.querySelectorAll('#drive button')].at(-1).click()")
            until(page.ended.is_set)
            tab.until("document.querySelector('.now').textContent.startsWith('ended')")
