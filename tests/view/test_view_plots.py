"""Figures: what their lines are, and what is told at their ends."""

from dataclasses import replace

import matplotlib
import matplotlib.pyplot
import nbformat
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from nbclient import NotebookClient
from pages import fallen, humanoid, walking

from featherstone_gait import Trajectory, load_robot, plot, show
from featherstone_gait.view.style import COLORS, spread

matplotlib.use("Agg")


@pytest.fixture(autouse=True)
def closed():
    yield
    matplotlib.pyplot.close("all")


def lines(axes):
    """Lines with a name."""
    return {line.get_label(): line for line in axes.lines if not line.get_label().startswith("_")}


def test_many_joints_are_drawn_left_beside_right_with_partners_in_one_color():
    run = walking(load_robot("humanoid"))
    left, right, others = plot(run, "q").axes
    assert [axes.get_title() for axes in (left, right, others)] == ["left", "right", "others"]
    names = [*lines(left), *lines(right), *lines(others)]
    assert sorted(names) == sorted(run.info["joints"])
    for name, line in lines(left).items():
        assert line.get_color() == lines(right)[name.replace("left", "right")].get_color()
        assert line.get_ydata() == pytest.approx(run["q"][:, run.info["joints"].index(name)])
    assert left.get_ylim() == right.get_ylim()
    kinds = {(line.get_color(), line.get_linestyle()) for line in lines(left).values()}
    assert len(kinds) == len(lines(left)) == 9


def test_in_given_axes_partners_are_told_apart_by_their_stroke():
    _, axes = matplotlib.pyplot.subplots()
    plot(walking(humanoid()), "q", axes=axes)
    drawn = lines(axes)
    assert len(drawn) == 10
    assert drawn["left_knee"].get_color() == drawn["right_knee"].get_color()
    assert (drawn["left_knee"].get_linestyle(), drawn["right_knee"].get_linestyle()) == ("-", "--")


def test_names_are_drawn_as_they_are_written(tmp_path):
    """Not as formulas, which names with dollars may not even be."""
    names = ["$\\frac$", "a$b", "@data@"]
    values = {"time": np.linspace(0, 1, 5), "q": np.eye(5)[:, :3]}
    run = Trajectory(values, "ok", "", 1.0, np.zeros(0), {"joints": names})
    figure = plot(run, "q")
    figure.savefig(tmp_path / "q.png")
    assert {text.get_text() for text in figure.axes[0].texts} == {*names}


@pytest.mark.parametrize("name", ["@data@", "$data", "${script}", "{data}", "%(data)s"])
def test_a_page_of_a_robot_with_an_odd_name_has_its_data_once(name, tmp_path):
    model = load_robot("humanoid")
    run, odd = walking(model), replace(model, name=name)
    page, plain = (show(run, one, path=tmp_path / "page.html").html for one in (odd, model))
    assert page.count('"links"') == plain.count('"links"')
    assert name in page


def test_labels_stand_at_the_ends_of_lines_and_apart():
    values = {"time": np.linspace(0, 1, 5), "q": np.outer(np.ones(5), [0.0, 0.001, 1.0])}
    run = Trajectory(values, "ok", "", 1.0, np.zeros(0), {"joints": ["low_joint", "near", "high"]})
    (axes,) = plot(run, "q").axes
    assert axes.get_legend() is None
    places = {text.get_text(): text.xy for text in axes.texts}
    assert set(places) == {"low joint", "near", "high"}
    assert places["near"][1] - places["low joint"][1] > 0.05
    assert places["high"][1] > places["near"][1]


def test_a_failed_run_is_drawn_to_its_failure_which_is_told():
    run = fallen(humanoid(), at=1.0)
    for axes in plot(run, "contact_force", "energy").axes:
        assert max(line.get_xdata().max() for line in lines(axes).values()) == 1.0
        assert "fell at 1 s" in [text.get_text() for text in axes.texts]
    doubtful = walking(humanoid(), status="inaccurate", message="from 0.1 s on")
    (axes,) = plot(doubtful, "energy").axes
    assert "inaccurate" in [text.get_text() for text in axes.texts]
    assert max(line.get_xdata().max() for line in lines(axes).values()) == 2.0


def dichromat(color):
    """A color as those see it who lack the red or the green cones, in linear RGB (F. Vienot et al., 1999)."""
    linear = np.array([x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in to_rgb(color)])
    lms = np.array([[17.8824, 43.5161, 4.11935], [3.45565, 27.1554, 3.86714], [0.0299566, 0.184309, 1.46709]])
    seen = lms @ linear
    without_red = np.array([2.02344 * seen[1] - 2.52581 * seen[2], seen[1], seen[2]])
    without_green = np.array([seen[0], 0.494207 * seen[0] + 1.24827 * seen[2], seen[2]])
    return [np.linalg.solve(lms, x) for x in (without_red, without_green)]


def test_colors_differ_for_those_who_lack_red_or_green_cones():
    for k in range(2):
        seen = np.array([dichromat(color)[k] for color in COLORS])
        apart = np.linalg.norm(seen[:, None] - seen[None], axis=2) + np.eye(len(seen))
        assert apart.min() > 0.04
    assert np.linalg.norm(np.subtract(*[dichromat(c)[1] for c in ("#d62728", "#2ca02c")])) < 0.3  # red and green


def test_labels_move_no_farther_than_they_must():
    assert spread(np.array([0.1, 0.5, 0.9]), 0.1) == pytest.approx([0.1, 0.5, 0.9])
    assert spread(np.array([0.5, 0.5]), 0.1) == pytest.approx([0.45, 0.55])
    assert spread(np.array([0.9, 0.95, 0.99]), 0.1) == pytest.approx([0.8, 0.9, 1.0])
    for n in (5, 11, 30):
        places = spread(np.zeros(n), 0.1)
        assert np.diff(places).min() >= min(0.1, 1.0 / (n - 1)) - 1e-12
        assert places.min() >= -1e-12
        assert places.max() <= 1.0 + 1e-12


@pytest.mark.parametrize(
    ("types", "units"),
    [(["revolute"], ["q [rad]", "qd [rad/s]", "torque [N m]"]), (["prismatic"], ["q [m]", "qd [m/s]", "torque [N]"])],
)
def test_axes_have_the_unit_of_the_joint(types, units):
    values = {"time": np.linspace(0, 1, 5)} | {name: np.zeros((5, 1)) for name in ("q", "qd", "torque")}
    run = Trajectory(values, "ok", "", 1.0, np.zeros(0), {"joints": ["one"], "joint_types": types})
    assert [axes.get_ylabel() for axes in plot(run).axes] == units


def test_lines_have_units_where_joints_turn_and_slide():
    values = {"time": np.linspace(0, 1, 5), "q": np.outer(np.ones(5), [0.0, 1.0]), "power": np.zeros((5, 2))}
    run = Trajectory(
        values, "ok", "", 1.0, np.zeros(0), {"joints": ["cart", "pole"], "joint_types": ["prismatic", "continuous"]}
    )
    positions, power = plot(run).axes
    assert {text.get_text() for text in positions.texts} == {"cart [m]", "pole [rad]"}
    assert {text.get_text() for text in power.texts} == {"cart", "pole"}


def test_names_are_no_formulas():
    values = {"time": np.linspace(0, 1, 5), "q": np.zeros((5, 2))}
    run = Trajectory(values, "ok", "", 1.0, np.zeros(0), {"joints": ["$\\frac$", "a$b$"]})
    figure = plot(run, "q")
    figure.draw_without_rendering()
    assert {text.get_text() for text in figure.axes[0].texts} == {"$\\frac$", "a$b$"}


@pytest.mark.long
@pytest.mark.parametrize("last", ["plot(run)", "figure", "plot(run);", "_ = plot(run); 1", "plot(run, 'q', axes=axes)"])
def test_a_notebook_draws_a_figure_once(last, tmp_path, monkeypatch):
    """A figure is shown once where it is made, as a later cell's value, and in another figure's axes."""
    first = (
        "import numpy as np\nfrom matplotlib import pyplot\nfrom featherstone_gait import Trajectory, plot\n"
        "values = {'time': np.linspace(0, 1, 5), 'q': np.zeros((5, 2))}\n"
        "run = Trajectory(values, 'ok', '', 1.0, np.zeros(0), {'joints': ['one', 'two']})\n"
    )
    cells = [first, "figure = plot(run)" if last == "figure" else "pass"]
    cells.append("_, axes = pyplot.subplots()\n" * ("axes" in last) + last)
    monkeypatch.delenv("MPLBACKEND", raising=False)
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    NotebookClient(notebook, timeout=300, resources={"metadata": {"path": tmp_path}}).execute()
    pictures = [sum("image/png" in output.get("data", {}) for output in cell.outputs) for cell in notebook.cells]
    assert pictures == [0, int(last == "figure"), 1]
