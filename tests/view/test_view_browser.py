"""Pages that show runs, in a headless Chromium: what is seen, keys, sizes, wishes of people who look."""

import pytest
from browser import found_in
from pages import fallen, humanoid, walking

from featherstone_gait import Ground
from featherstone_gait.view.page import page_html, render
from featherstone_gait.view.recorded import Seen

SIZES = ((1280, 720), (375, 667), (800, 420), (320, 568))

PIXELS = """
const pixels = c => {  // read from a copy, as the browser advises
  const copy = document.createElement("canvas"), g = copy.getContext("2d", {willReadFrequently: true});
  copy.width = c.width; copy.height = c.height; g.drawImage(c, 0, 0);
  return g.getImageData(0, 0, c.width, c.height).data;
};
"""

LOOK = """
const rect = id => document.getElementById(id).getBoundingClientRect(), told = {};
viewer.show();
told.wide = document.documentElement.scrollWidth - innerWidth;
told.controls = rect("controls").bottom - innerHeight;
const least = innerWidth <= 600 || innerHeight <= 500 ? 40 : 30;  // fingers need 40 pixels
told.hidden = [...document.querySelectorAll("#controls button, #controls select, #time")].filter(e => {
  const r = e.getBoundingClientRect();
  const high = e.id === "time" ? 16 : least;
  return r.right > innerWidth || r.bottom > innerHeight + 0.5 || r.width < least - 2 || r.height < high;
}).map(e => e.textContent);
const ofPlots = [...document.querySelectorAll("#plots button, #plots select")];
told.small = ofPlots.filter(e => e.getBoundingClientRect().height < least - 4).length;
told.play = rect("play").width * rect("play").height;
told.picture = [...document.querySelectorAll("#views canvas")].map(c => {
  const d = pixels(c), seen = new Set();
  for (let k = 0; k < d.length; k += 40) seen.add(d[k] << 16 | d[k + 1] << 8 | d[k + 2]);
  return [c.clientHeight, seen.size, c.getBoundingClientRect().top < innerHeight];
});
told.names = [...document.querySelectorAll("button, select, input, canvas")].filter(e => !(e.getAttribute("aria-label")
  || e.textContent.trim() && e.tagName === "BUTTON")).length;
return told;
"""

KEYS = """
const told = {}, press = (key, on = document.body, more = {}) =>
  on.dispatchEvent(new KeyboardEvent("keydown", {key, bubbles: true, cancelable: true, ...more}));
const s = viewer.state, v = viewer.view, times = viewer.data.runs[0].times;
const at = k => Math.abs(s.time - times[k]) < 1e-9;
told.plays = s.playing; press(" "); told.paused = !s.playing; press(" "); told.again = s.playing;
press("Home"); told.home = at(0) && !s.playing;
press("ArrowRight"); told.one = at(1); press("ArrowRight", document.body, {shiftKey: true}); told.ten = at(11);
press("ArrowLeft"); told.back = at(10); viewer.go((times[3] + times[4]) / 2); press("ArrowLeft"); told.between = at(3);
press("End"); told.end = at(times.length - 1);
press("3"); told.front = v.yaw === 0; press("4"); told.top = v.pitch > 1.5; press("2"); told.side = v.pitch < 0.1;
const span = v.span; press("+"); told.closer = v.span < span;
press("-"); told.farther = Math.abs(v.span / span - 1) < 1e-9;
const yaw = v.yaw; press("d"); told.turned = v.yaw < yaw;
const canvas = document.querySelector("#views canvas"), before = v.yaw, time = s.time;
press("ArrowLeft", canvas); told.canvas = v.yaw > before && s.time === time;
const button = [...document.querySelectorAll("#toggles button")].find(b => b.textContent === "forces");
press("f"); told.forces = button.getAttribute("aria-pressed") === "false"; press("f");
press("g"); told.ghosts = document.querySelectorAll("#views canvas").length === 1; viewer.show(); press("g");
press("l"); viewer.show(); told.load = viewer.shown.load; press("l");
const rate = document.getElementById("rate"); press("["); told.slower = rate.value === "0.5"; press("]");
press("?"); told.help = document.getElementById("help").open; press("?");
press("1", document.getElementById("rate")); told.select = v.pitch < 0.1;
return told;
"""

HANDS = """
const c = document.querySelector("#views canvas"), v = viewer.view, told = {};
c.setPointerCapture = () => {};
const finger = (type, id, x, y, more = {}) => c.dispatchEvent(new PointerEvent("pointer" + type,
  {pointerId: id, clientX: x, clientY: y, buttons: type === "up" ? 0 : 1, bubbles: true, ...more}));
const yaw = v.yaw, pitch = v.pitch, span = v.span;
finger("down", 1, 100, 100); finger("move", 1, 130, 110);
told.turn = [v.yaw - yaw, v.pitch - pitch];
finger("down", 2, 230, 110); finger("move", 2, 330, 110);
told.pinch = v.span / span;
told.moved = v.pan.some(x => x !== 0);
finger("up", 1, 130, 110); finger("up", 2, 330, 110);
const before = v.yaw; finger("move", 1, 200, 200); told.lifted = v.yaw === before;
v.pan = [0, 0, 0]; finger("down", 3, 100, 100, {shiftKey: true}); finger("move", 3, 140, 100, {shiftKey: true});
told.shift = v.yaw === before && v.pan.some(x => x !== 0); finger("up", 3, 140, 100);
const near = v.span; c.dispatchEvent(new WheelEvent("wheel", {deltaY: 100, cancelable: true}));
told.wheel = v.span / near;
return told;
"""

LEVELS = """
let n = 0;
for (const name of ["lineTo", "moveTo"]) {
  const own = CanvasRenderingContext2D.prototype[name];
  CanvasRenderingContext2D.prototype[name] = function (...x) { n++; return own.apply(this, x); };
}
viewer.go(0.5);
return [0.5, 1, 5, 10, 100].map(span => { viewer.view.span = span; n = 0; viewer.show(); return n; });
"""

LEVEL_VIEW = """
viewer.go(0.5); viewer.view.pitch = 0; viewer.show();
const c = document.querySelector("#views canvas"), d = pixels(c);
const at = y => { const k = 4 * (Math.round(y * c.height) * c.width + 4); return [d[k], d[k + 1], d[k + 2]].join(); };
return [at(0.02), at(0.6), at(0.97)];
"""

FAILURE = """
const run = viewer.data.runs[1], told = {};
told.status = [...document.querySelectorAll(".status")].map(e => e.textContent);
told.same = JSON.stringify(poses(run, 1.7)) === JSON.stringify(poses(run, run.end));
told.moved = JSON.stringify(poses(run, 0.7)) !== JSON.stringify(poses(run, run.end));
told.other = JSON.stringify(poses(viewer.data.runs[0], 1.7)) !== JSON.stringify(poses(viewer.data.runs[0], 1.0));
told.label = document.querySelectorAll("#views canvas")[1].getAttribute("aria-label");
const words = [], own = CanvasRenderingContext2D.prototype.fillText;
CanvasRenderingContext2D.prototype.fillText = function (...x) { words.push(x[0]); return own.apply(this, x); };
viewer.go(0.7); viewer.show(); told.before = words.includes("fell at 1.00 s"); viewer.go(1.7); viewer.show();
told.stamp = words.includes("fell at 1.00 s");
return told;
"""

PLOTS = """
const plot = viewer.plots[0], told = {};
viewer.go(1.0); viewer.show();
const [torque] = plot.lines.filter(line => line.label === "left_knee");
told.value = valueAt(torque); told.cursor = plot.X(viewer.state.time);
viewer.go(1.5); viewer.show(); told.later = plot.X(viewer.state.time);
const at = (1.25 - 0) / 2 * plot.box.w + plot.box.x, box = plot.canvas.getBoundingClientRect();
plot.canvas.setPointerCapture = () => {};
plot.canvas.dispatchEvent(new PointerEvent("pointerdown", {clientX: box.left + at, clientY: box.top + 40, buttons: 1}));
told.sought = viewer.state.time;
[...document.querySelectorAll("#plots button")].at(-1).click(); told.two = viewer.plots.length;
return told;
"""


@pytest.fixture(scope="module")
def page():
    model = humanoid()
    runs = {"walks": walking(model), "falls": fallen(model)}
    return page_html({name: Seen(model, run, Ground()) for name, run in runs.items()}, "two", ["torque"])


@pytest.fixture(scope="module")
def seen(page, tmp_path_factory):
    """What one browser finds in the page at all sizes, and with each script."""
    folder = tmp_path_factory.mktemp("browser")
    parts = {
        "look": LOOK, "keys": KEYS, "hands": HANDS, "levels": LEVELS, "level": LEVEL_VIEW, "failure": FAILURE,
        "plots": PLOTS,
    }  # fmt: skip
    calls = ",".join(f"{name}: (() => {{{script}}})()" for name, script in parts.items())
    found, console = found_in(page, f"{PIXELS} return {{{calls}}};", folder, sizes=SIZES)
    assert console == []
    assert [one for one in found if isinstance(one, str)] == []
    return dict(zip(SIZES, found))


@pytest.mark.parametrize("size", SIZES)
def test_picture_and_controls_are_in_sight(seen, size):
    look = seen[size]["look"]
    assert look["wide"] <= 0
    assert look["controls"] <= 0.5
    assert look["hidden"] == []
    assert look["small"] == 0
    assert look["play"] > 1000
    assert look["names"] == 0
    assert len(look["picture"]) == 2
    for height, colors, in_sight in look["picture"]:
        assert height >= 110
        assert colors > 20
        assert in_sight


def test_every_key_does_what_the_page_says(seen):
    keys = seen[SIZES[0]]["keys"]
    assert [name for name, done in keys.items() if not done] == []
    assert len(keys) > 20


def test_fingers_and_the_mouse_turn_move_and_zoom(seen):
    hands = seen[SIZES[1]]["hands"]
    assert hands["turn"] == pytest.approx([-0.3, 0.1])
    assert hands["pinch"] == pytest.approx(0.5)  # fingers from 100 to 200 pixels apart
    assert hands["wheel"] == pytest.approx(1.105, abs=1e-3)
    assert hands["moved"]
    assert hands["lifted"]
    assert hands["shift"]


def test_the_ground_costs_as_much_at_any_distance(seen):
    counts = seen[SIZES[0]]["levels"]
    assert max(counts) < 2 * min(counts)
    assert max(counts) < 20_000


def test_the_ground_is_seen_level(seen):
    sky, ground, near = seen[SIZES[0]]["level"]
    assert sky != ground
    assert sky != near


def test_a_failed_run_says_so_and_stands_still(seen):
    told = seen[SIZES[0]]["failure"]
    assert told.pop("status") == ["ok", "fell at 1.00 s"]
    assert told.pop("label").endswith("falls: fell at 1.00 s")
    assert told == {"same": True, "moved": True, "other": True, "before": False, "stamp": True}


def test_plots_follow_the_time_and_the_time_follows_them(seen):
    told = seen[SIZES[0]]["plots"]
    run = walking(humanoid())
    exact = run["torque"][100, run.info["joints"].index("left_knee")]
    assert told["value"] == pytest.approx(exact, abs=1e-4)
    assert told["later"] > told["cursor"]
    assert told["sought"] == pytest.approx(1.25, abs=0.01)
    assert told["two"] == 2


@pytest.mark.quick("flags1-*")
@pytest.mark.parametrize(("flags", "plays"), [((), True), (("--force-prefers-reduced-motion",), False)])
def test_nothing_moves_by_itself_for_those_who_do_not_want_it(page, tmp_path, flags, plays):
    (told,), console = found_in(page, "return viewer.state.playing;", tmp_path, *flags)
    assert told is plays
    assert console == []


def test_a_dark_desktop_gets_a_dark_page(page, tmp_path):
    script = "viewer.show(); return getComputedStyle(document.body).backgroundColor + colors.sky;"
    (told,), _ = found_in(page, script, tmp_path, "--force-dark-mode")
    assert told == "rgb(20, 24, 28)#1b232c"


REPORT = """
const told = {}, texts = query => [...document.querySelectorAll("#report " + query)].map(e => e.textContent);
told.controls = document.getElementById("controls").getBoundingClientRect().height;
told.wide = document.documentElement.scrollWidth - innerWidth;
told.lead = texts("> p"); told.tiles = texts(".tile"); told.titles = texts("h2"); told.cells = texts("td");
told.rows = texts("tbody th"); told.bold = texts("b"); told.code = texts("code"); told.bad = texts("td .bad");
told.links = [...document.querySelectorAll("#report a")].map(e => [e.textContent, e.getAttribute("href")]);
told.charts = texts("svg text"); told.dots = document.querySelectorAll("circle.dot").length;
told.best = document.querySelector("polyline").getAttribute("points").split(" ").length;
told.heights = [...document.querySelectorAll("#report svg")].map(e => e.getBoundingClientRect().height > 60);
return told;
"""


def test_a_report_is_drawn_by_the_same_page(tmp_path):
    costs, best = [90.0, 80.0, None, 85.0, 70.0], [90.0, 80.0, 80.0, 80.0, 70.0]
    parts = [
        {"text": "**Not** run: `featherstone-gait <x>`", "soft": False},
        {"head": ["", "file"], "rows": [["all", {"text": "a b.json", "link": "./a%20b.json"}]]},
        {"head": ["", "here"], "rows": [[{"text": "<name>"}, {"text": "3 ", "small": "m", "mark": ["bad", "falls"]}]]},
        {"chart": "intervals", "what": "cost", "rows": [["plan", 40.0, 50.0, 60.0], ["found", 30.0, 35.0, 41.0]]},
        {"chart": "search", "what": "search", "at": [0, 1, 2, 2, 50], "costs": costs, "best": best, "since": 3},
    ]
    report = {"lead": "lead", "tiles": [["speed", "2 m/s", "note"]], "sections": [{"title": "Part", "parts": parts}]}
    (told,), console = found_in(render("report", {"report": report}), REPORT, tmp_path, sizes=(SIZES[1],))
    assert console == []
    assert (told["controls"], told["wide"] <= 0, told["heights"]) == (0, True, [True, True])
    assert (told["lead"], told["tiles"], told["titles"]) == (["lead"], ["speed2 m/snote"], ["Part"])
    assert (told["rows"], told["cells"], told["bad"]) == (["all", "<name>"], ["a b.json", "3 fallsm"], ["falls"])
    assert told["links"] == [["a b.json", "./a%20b.json"]]
    assert ("Not" in told["bold"], told["code"]) == (True, ["featherstone-gait <x>"])
    assert {"plan", "found", "with limits", "50"} <= set(told["charts"])
    assert (told["dots"], told["best"]) == (4, 5)
