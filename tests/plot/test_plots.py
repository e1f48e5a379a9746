"""Pictures are checked by what is drawn in them: lines, cells, marks and scales."""

import numpy as np
import pytest
from matplotlib.figure import Figure

import mbtl
from flat import created, told
from mbtl.plot.maps import BELIEVED
from mbtl.selectors.outlook import outlook
from mbtl.zoo.benchmark import TransferMatrix

N = 20
LINE = mbtl.ContextSpace.grid({mbtl.Log("mass", 0.1, 10.0, unit="kg"): N})
PLANE = mbtl.ContextSpace.grid(
    {mbtl.Log("mass", 0.1, 10.0, unit="kg"): 6, mbtl.Linear("length", 0.0, 1.0, unit="m"): 5}
)


def row(space, source):
    return 0.9 - 0.5 * np.linalg.norm(space.unit - space.unit[source], axis=1)


def study_on(space, picks=4, strategy="mbtl"):
    study = created(space, budget=6, bounds=(0.0, 1.0), problem="toy", strategy=strategy)
    return told(study, lambda source: row(space, source), picks)


def texts(ax):
    return [text.get_text() for text in ax.texts]


def test_the_curve_is_the_running_estimate_of_v_beside_named_baselines_on_axes_of_the_users():
    study = study_on(LINE)
    given = Figure().subplots()
    ax = mbtl.plot.curve(
        study, baselines={"Random": np.full((3, 6), 0.5)}, levels={"unguided": 0.2}, ax=given
    )
    assert ax is given
    lines = {line.get_label(): line.get_ydata() for line in ax.get_lines()}
    assert lines["mbtl, estimated"] == pytest.approx(study.curve)
    assert lines["Random"] == pytest.approx([0.5] * 6)
    assert {"unguided"} <= set(lines)
    assert mbtl.plot.curve([0.1, 0.2]).get_lines()[0].get_ydata().tolist() == [0.1, 0.2]


def names_in(ax):
    """Policies, from 0, that are named at what they are trained on."""
    return sorted(int(n) - 1 for text in ax.texts for n in text.get_text().split(","))


def legend_of(ax):
    """Words by policy, from 0, and its colour."""
    legend = ax.get_legend()
    words = [text.get_text() for text in legend.get_texts()]
    colours = [patch.get_facecolor() for patch in legend.get_patches()]
    return {int(w.split(":")[0]) - 1: (w, c) for w, c in zip(words, colours, strict=True)}


def test_a_policy_map_on_a_logarithmic_axis_is_drawn_as_such_and_names_whom_it_shows():
    study = study_on(LINE)
    ax, route = mbtl.plot.policy_map(study), study.routing.route
    assert ax.get_xscale() == "log"
    assert ax.get_xlabel() == "mass [kg]"
    assert "by the episodes that chose" in ax.get_ylabel()
    legend = legend_of(ax)
    assert set(legend) == set(route.tolist())
    for policy, (words, colour) in legend.items():
        source = study.routing.sources[policy]
        said = f"{LINE.describe(LINE.context(source))} ({(route == policy).sum()})"
        assert words == f"{policy + 1}: {said}"
        (drawn,) = (d for d in ax.get_lines() if d.get_marker() == "s" and d.get_color() == colour)
        assert set(drawn.get_xdata()) == set(np.array(LINE.values("mass"))[route == policy])
    assert names_in(ax) == [0, 1, 2, 3]
    assert mbtl.plot.policy_map(study.portfolio()).get_xscale() == "log"


ROADS = ("wet", "dry", "icy")
SOLID = mbtl.ContextSpace.grid(
    {
        mbtl.Categorical("road", ROADS): 3,
        mbtl.Log("mass", 0.1, 10.0, unit="kg"): 6,
        mbtl.Linear("length", 0.0, 1.0, unit="m"): 5,
    }
)


def test_three_axes_are_a_map_at_the_middle_of_the_third_and_every_cell_is_the_route():
    study = study_on(SOLID, 6)
    ax = mbtl.plot.policy_map(study)
    legend = legend_of(ax)
    assert set(legend) == set(study.routing.route.tolist())
    route = study.routing.route.reshape(3, 6, 5)[1]
    assert ax.get_title("left") == "which policy serves at road = dry"
    mesh = ax.collections[0]
    shown = mesh.cmap(mesh.norm(np.asarray(mesh.get_array())))
    expected = np.array([[legend[p][1] for p in row] for row in route.T])
    assert shown == pytest.approx(expected, abs=0.01)
    road = SOLID.values("road")
    assert names_in(ax) == [p for p, s in enumerate(study.routing.sources) if road[s] == "dry"]


def test_more_axes_are_one_map_at_the_middle_of_the_others_and_points_one_of_all():
    axes = {"a": 5, "b": 4, "c": 3, "d": 3}
    space = mbtl.ContextSpace.grid({mbtl.Linear(a, 0.0, 1.0): n for a, n in axes.items()})
    study = study_on(space, 2)
    ax = mbtl.plot.policy_map(study)
    assert "at c = 0.5, d = 0.5" in ax.get_title("left")
    middle = study.routing.route.reshape(5, 4, 3, 3)[:, :, 1, 1]
    codes = np.asarray(ax.collections[0].get_array())
    np.testing.assert_array_equal(codes.T, np.searchsorted(np.unique(study.routing.route), middle))
    turned = mbtl.plot.policy_map(study, over=("c", "d"))
    assert turned.collections[0].get_array().shape == (3, 3)
    points = mbtl.ContextSpace.points(space.axes, space.contexts[:160:4])
    ax = mbtl.plot.policy_map(study_on(points, 2, "random"))
    assert len(ax.collections[0].get_offsets()) == 40


def test_numbers_of_sources_side_by_side_do_not_hide_each_other():
    space = mbtl.ContextSpace.grid({mbtl.Linear("x", 0.0, 1.0): 100})
    study = created(space, budget=3, bounds=(0.0, 1.0))
    for source in (50, 51, 52):
        study.tell(source, row(space, source))
    ax = mbtl.plot.policy_map(study)
    heights = [note.xyann[1] for note in ax.texts]
    assert len(set(heights)) == 3


def test_two_axes_are_a_map_of_the_policies_or_of_what_the_model_believed():
    study = study_on(PLANE)
    chart = mbtl.plot.policy_map(study)
    legend = legend_of(chart)
    assert np.unique(chart.collections[0].get_array()).tolist() == list(range(len(legend)))
    assert set(legend) == set(study.routing.route.tolist())
    ax = mbtl.plot.model(study)
    believed = outlook(study.problem, study.history, "mbtl", after=4).mean
    assert ax.collections[0].get_array()[2, 3] == pytest.approx(believed[3 * 5 + 2])
    assert ax.collections[0].get_array().shape == (5, 6)
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "linear")
    assert texts(ax) == ["1", "2", "3", "4"]
    assert BELIEVED in [other.get_ylabel() for other in ax.figure.axes]


def test_what_cannot_be_drawn_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    on_all = created(LINE, budget=3)
    on_all.tell(range(N), row(LINE, 3))
    for draw, words in (
        (lambda: mbtl.plot.policy_map(study_on(PLANE, 1), over=("mass", "mass")), "two of the axe"),
        (lambda: mbtl.plot.model(study_on(LINE, 1), 0), "rows to be fitted"),
        (lambda: mbtl.plot.model(on_all), r"of specialists .*, got none in 1 training; mb"),
        (lambda: mbtl.plot.matrix("toy.npz"), r"matrix\(mbtl.TransferMatrix.load\('toy"),
        (lambda: mbtl.plot.save(mbtl.plot.curve([0.1]), tmp_path / "file/x.png"), "another place"),
    ):
        with pytest.raises(mbtl.MbtlError, match=words):
            draw()


def test_the_model_is_the_selectors_own_and_the_triangle_is_the_pick_that_came_next():
    study = study_on(LINE, 6)
    ax = mbtl.plot.model(study, 5)
    assert ax.get_title(loc="left") == "mbtl after 5 trainings"
    below = next(other for other in ax.figure.axes if other is not ax)
    (triangle,) = below.get_lines()
    mass = LINE.values("mass")
    assert triangle.get_xdata()[0] == mass[study.history.sources[5]]
    (gain,) = below.collections  # its peak is where the study picked
    points = gain.get_paths()[0].vertices
    assert points[points[:, 1].argmax(), 0] == pytest.approx(triangle.get_xdata()[0])


def test_a_matrix_of_fewer_sources_than_targets_has_as_many_rows():
    rng = np.random.default_rng(0)
    returns = rng.random((2, 4, N))
    sources = np.array([0, 6, 12, 18])
    matrix = TransferMatrix.of(returns, space=LINE, bounds=(0, 1), sources=sources, name="toy")
    ax = mbtl.plot.matrix(matrix, picks=[6, 0])
    mesh = ax.collections[0]
    assert np.asarray(mesh.get_array()) == pytest.approx(returns.mean(axis=0))
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert ax.get_title(loc="left") == "toy, mean of 2 seeds"
    assert texts(ax) == ["2", "1"]
    first = mbtl.plot.matrix(matrix, 0).collections[0].get_array()
    assert np.asarray(first) == pytest.approx(returns[0])


def test_pictures_are_written_in_the_format_of_their_ending(tmp_path):
    for ending, begin in (("png", b"\x89PNG"), ("svg", b"<?xml")):
        path = mbtl.plot.save(mbtl.plot.curve([0.1, 0.3]), tmp_path / "new" / f"x.{ending}")
        assert path.read_bytes().startswith(begin)


def test_a_curve_has_the_intervals_of_the_episodes_it_is_of():
    study = created(LINE, budget=3, bounds=(0.0, 1.0))
    for pick, base in zip(study.ask(3), (0.2, 0.5, 0.6), strict=True):
        study.tell(pick, base + 0.1 * np.random.default_rng(0).standard_normal((LINE.n, 4)))
    ax = mbtl.plot.curve(study)
    (bars,) = ax.collections[0].get_segments()[-1:]
    assert np.ptp(bars[:, 1]) / 2 == pytest.approx(study.routing.value.margin)
    assert "estimated" in ax.get_legend_handles_labels()[1][0]


def test_a_comparison_is_its_table_a_frame_and_a_picture(mbtl_command, monkeypatch):
    names, synthetic = ["random", "greedy", "oracle"], "synthetic:linear-gap"
    comparison = mbtl.compare(names, [synthetic], budget=3, seeds=1)
    command = ("bench", "--matrix", synthetic, "--budget", "3", "--seeds", "1")
    monkeypatch.setenv("COLUMNS", "90")
    _, printed, _ = mbtl_command(*command, "--selectors", ",".join(names))
    printed = "\n".join(line.rstrip() for line in printed.splitlines())
    assert repr(comparison) == printed.rstrip("\n")
    frame = comparison.to_frame()
    assert list(frame.columns) == ["matrix", "matrix_seed", "selector", "seed", "k", "source", "V"]
    run = next(r for r in comparison.results if r.selector == "greedy")
    mine = frame[(frame.selector == run.selector) & (frame.seed == run.seed)]
    assert mine.V.tolist() == pytest.approx(run.performance.tolist())
    assert mine.source.tolist() == list(run.sources)
    lines = {line.get_label(): line.get_ydata() for line in comparison.plot().get_lines()}
    (one,) = comparison.summary.matrices.values()
    assert lines["Random"] == pytest.approx(one.random)
    assert lines["greedy"] == pytest.approx(run.performance)
    chance = frame[frame.selector == "random"]  # as in the table: exact, of no one order
    assert chance.V.tolist() == pytest.approx(one.random)
    assert chance.source.isna().all()
    with pytest.raises(mbtl.MbtlError, match=r"matrix must be one of .* plot\('synthetic"):
        comparison.plot("other")
