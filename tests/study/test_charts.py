import numpy as np
import pytest

from servoscope.poses import DOFS
from servoscope.selection import CRITERIA
from servoscope.study.charts import (
    SIGNED,
    draw_best_features,
    draw_criteria,
    draw_eigenvectors,
    draw_redundancies,
    plot_best_feature,
    plot_criteria,
    plot_family_errors,
    plot_locations,
    plot_redundancy,
    plot_selection_plane,
    plot_signed,
    plot_slices,
    plot_sweep,
)
from servoscope.study.figures import list_figures
from servoscope.study.page import describe_criteria
from servoscope.study.results import read_run
from servoscope.study.tables import criteria_table

SWEEP = [
    {"thresholds": [0.0, 0.05], "n_features": 24, "rms": 0.2, "validation_rms": 0.18},
    {"thresholds": [0.1], "n_features": 7, "rms": 0.1, "validation_rms": 0.09},
]


def texts(ax):
    return [text.get_text() for text in ax.texts]


def test_best_feature_has_its_name_and_the_unit_of_the_dof():
    ax = plot_best_feature([1.0, 2.0], [-5.0, 5.0], "theta_50", "rz")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("theta_50", "Rz [deg]")
    assert plot_best_feature([1.0], [1.0], "x_50", "tx").get_ylabel() == "Tx [mm]"


def test_displacements_are_drawn_in_mm_and_degrees():
    values = dict.fromkeys(DOFS, np.array([0.0, 1.0]))
    delta_p = np.array([[0.01] * 3 + [np.pi / 18] * 3, [0.0] * 6])
    figure = draw_best_features(values, dict.fromkeys(DOFS, "x_50"), delta_p)
    assert [ax.lines[0].get_ydata()[0] for ax in figure.axes] == pytest.approx([10.0] * 6)


def test_plane_circles_and_names_the_candidate_nearest_to_the_ideal_point():
    # x_50 is selected already; the others are 0.5, 0.4 and 0.9 from the ideal point (0, 1)
    relevance, redundancy = [2.0, 1.0, 0.6, 0.1], [np.nan, 0.5, 0.0, 0.0]
    ax = plot_selection_plane(relevance, redundancy, ["x_50", "y_50", "e_00", "e_01"])
    assert texts(ax) == ["e_00"]
    (circle,) = [line for line in ax.lines if line.get_markerfacecolor() == "none"]
    assert (circle.get_xdata(), circle.get_ydata()) == ([0.0], [0.6])
    assert "[bits]" in ax.get_xlabel()
    assert "[bits]" in ax.get_ylabel()


def test_contours_join_equal_distances_to_the_ideal_point():
    ax = plot_selection_plane([1.0, 0.2], [0.5, 0.1], ["x_50", "e_00"])
    contours = [line for line in ax.lines if len(line.get_xdata()) > 2]
    assert len(contours) == 9
    for line in contours:
        assert np.ptp(np.hypot(line.get_xdata(), line.get_ydata() - 1.0)) < 1e-9


def test_sweep_counts_features_above_each_marker():
    ax = plot_sweep(SWEEP, dof="tx", scale=25.0, published=0.16)
    assert texts(ax) == ["24", "7"]
    assert ax.get_xlabel() == "threshold [bits]"
    assert len(ax.lines) == 3


def test_sweep_of_the_papers_protocol_has_no_validation_curve():
    ax = plot_sweep(SWEEP, dof="tx", scale=25.0, decided_on_test=True)
    assert len(ax.lines) == 1


def test_second_axis_of_a_sweep_is_in_the_unit_of_the_dof():
    (second,) = plot_sweep(SWEEP, dof="rx", scale=15.0).child_axes
    second.figure.draw_without_rendering()
    assert second.get_ylabel() == "[deg]"
    assert second.get_ylim()[1] == pytest.approx(15.0 * second._parent.get_ylim()[1])


def test_each_signed_picture_has_zero_in_the_middle_of_the_map_and_its_own_scale():
    images = plot_signed([[[-1.0, 0.5]], [[8.0, 2.0]]], ["a", "b"]).images
    assert [image.get_clim() for image in images] == [(-1, 1), (-1, 1)]
    assert [np.asarray(image.get_array()).tolist() for image in images] == [
        [[-1.0, 0.5]],
        [[1.0, 0.25]],
    ]


def test_lightness_alone_tells_the_sign():
    lightness = SIGNED(np.linspace(0, 1, 32))[:, :3] @ [0.299, 0.587, 0.114]
    assert (np.diff(lightness) > 0).all()


def test_picture_of_zeros_can_be_drawn():
    image = plot_signed(np.zeros((1, 4, 4)), ["zero"]).images[0]
    assert (np.asarray(image.get_array()) == 0).all()


def test_slice_shows_only_pixels_inside():
    ax = plot_slices(np.array([[49, 50, 99, 100]]), [(50, 100)])
    shown = np.asarray(ax.images[0].get_array())
    assert (shown[0] == 255).tolist() == [True, False, False, True]
    assert texts(ax) == ["grey 50 to 99"]


def test_crosses_stand_at_column_and_row_of_their_own_picture():
    locations = [[[1, 9], [7, 2]], [[0, 0], [3, 4]]]
    ax = plot_locations(np.ones((2, 8, 10)), locations, ["Tx", "Ty"])
    crosses = ax.lines[-1].get_xydata()
    left, _, bottom, top = ax.images[1].get_extent()
    assert crosses[:2].tolist() == [[9, 1], [2, 7]]
    assert crosses[2:] == pytest.approx(np.array([[0.5, 0.5], [4.5, 3.5]]) + np.array([left, top]))
    assert bottom - top == 8


def test_pictures_keep_their_proportions_and_do_not_overlap():
    ax = draw_eigenvectors(np.ones((7, 48, 64))).axes[0]
    extents = np.array([image.get_extent() for image in ax.images])
    left, right, bottom, top = extents.T
    assert right - left == pytest.approx(64)
    assert bottom - top == pytest.approx(48)
    assert ax.get_aspect() == 1.0
    assert left[1] > right[0]
    assert top[6] > bottom[0]
    assert left[6] == left[0]


def test_overview_shows_every_family_and_errors_in_mm_and_degrees(summary):
    ax = plot_family_errors(summary["protocols"]["honest"]["pivot"])
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels[:2] == ["GM", "PCA"]
    assert len(labels) == 6
    assert ax.get_xticklabels()[0].get_text() == "Tx\nGM: 1.8 mm"


def test_published_errors_stand_in_the_places_of_ours(summary):
    results = summary["protocols"]["honest"]["pivot"]
    ax = plot_family_errors(results, published=True)
    (dashes,) = [line for line in ax.lines if line.get_marker() == "_"]
    ours = [line for line in ax.lines if len(line.get_xdata()) == 6]
    expected = np.concatenate([line.get_xdata() for line in ours])
    assert dashes.get_xdata() == pytest.approx(expected)
    assert dashes.get_ydata()[:3] == pytest.approx([0.07, 0.05, 0.14])
    assert dashes.get_ydata()[-3:] == pytest.approx([0.05, 0.08, 0.03])


def test_published_errors_are_left_out_for_other_images(summary):
    ax = plot_family_errors(summary["protocols"]["honest"]["pivot"])
    assert not [line for line in ax.lines if line.get_marker() == "_"]


def test_every_unit_has_its_figures_and_eigenvectors_come_once_a_protocol(shared_run):
    names = [order.name for order in list_figures(read_run(shared_run))]
    assert len(names) == len(set(names)) == 4 + 4 * 8 + 2
    assert sum(name.endswith("_eigenvectors") for name in names) == 2


def test_criteria_differ_without_colour(compared):
    ax = plot_criteria(
        {name: by_dof["tx"] for name, by_dof in compared["errors"].items()},
        compared["sizes"],
        all_candidates=0.01,
    )
    styles = {(line.get_marker(), line.get_linestyle()) for line in ax.lines}
    assert len(styles) == len(CRITERIA) + 1
    assert [label.get_text() for label in ax.get_xticklabels()] == ["4", "8", "16", "24"]


def test_runs_with_a_criterion_that_is_gone_have_it_under_its_own_name(compared):
    compared["errors"]["mrmr"] = compared["errors"].pop("ideal_point")
    (legend,) = draw_criteria(compared).legends
    assert "mrmr" in [text.get_text() for text in legend.get_texts()]
    assert "mrmr" in criteria_table(compared).to_csv()
    assert describe_criteria(compared)


@pytest.mark.parametrize("n_dofs", [1, 6])
def test_legend_stays_on_the_figure_for_any_number_of_dofs(compared, n_dofs):
    dofs = list(compared["all_candidates"])[:n_dofs]
    compared["all_candidates"] = dict.fromkeys(dofs, 0.1)
    figure = draw_criteria(compared)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    box, whole = legend.get_window_extent(), figure.bbox
    assert box.x0 >= 0
    assert box.x1 <= whole.x1
    lowest = min(ax.xaxis.label.get_window_extent().y0 for ax in figure.axes)
    assert 0 <= box.y0 < box.y1 <= lowest


def test_redundancy_and_bias_differ_without_colour():
    parts = {"redundancy": 0.1, "bias": 0.05, "unrelated": 0.08}
    steps = [{part: slope * i for part, slope in parts.items()} for i in range(4)]
    ax = plot_redundancy(steps, dof="tx")
    redundancy, bias, unrelated = ax.lines
    assert redundancy.get_ydata() == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert bias.get_ydata() == pytest.approx([0.0, 0.05, 0.1, 0.15])
    assert unrelated.get_ydata() == pytest.approx([0.0, 0.08, 0.16, 0.24])
    assert len({line.get_linestyle() for line in ax.lines}) == 3
    assert ax.get_ylabel() == "[bits]"


def test_every_dof_has_its_panel(summary):
    results = summary["protocols"]["honest"]["pivot"]
    titles = [ax.get_title() for ax in draw_redundancies(results["redundancy_bias"]).axes]
    assert titles == ["Tx", "Ty", "Tz", "Rx", "Ry", "Rz"]
