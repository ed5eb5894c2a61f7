"""Figures in a narrow window: pictures one below the other, none on another, none lost."""

import itertools

import pytest

from spiral.app.narrow import fit_narrow, stack_columns
from spiral.view.report.style import blank_figure


def drawn(rows, columns, **options):
    figure = blank_figure(rows, columns, 100 + 300 * rows, **options)
    for row, column in itertools.product(range(1, rows + 1), range(1, columns + 1)):
        figure.add_scatter(x=[0, 1], y=[0, 1], row=row, col=column)
    return figure.to_plotly_json()


def domains(layout, letter):
    """Lower and upper end of every axis of a direction, in the order of their names."""
    names = sorted((n for n in layout if n.startswith(f"{letter}axis")), key=lambda n: (len(n), n))
    return [layout[n]["domain"] for n in names]


@pytest.mark.parametrize("linked", [True, False])
@pytest.mark.parametrize(("rows", "columns"), [(1, 2), (1, 3), (2, 2), (2, 5)])
def test_pictures_side_by_side_come_to_stand_one_below_the_other(rows, columns, linked):
    before = drawn(rows, columns, shared_xaxes=linked, horizontal_spacing=0.05)
    after = stack_columns(before)["layout"]
    assert domains(after, "x") == [[0.0, 1.0]] * (rows * columns)
    places = sorted(domains(after, "y"))
    assert places[0][0] == pytest.approx(0.0)
    assert places[-1][1] == pytest.approx(1.0)
    assert all(a[1] < b[0] for a, b in itertools.pairwise(places))
    inner = [before["layout"]["height"] - 102, after["height"] - 102]
    for old, new in zip(domains(before["layout"], "y"), domains(after, "y"), strict=True):
        assert (new[1] - new[0]) * inner[1] == pytest.approx((old[1] - old[0]) * inner[0])


def test_pictures_are_read_by_rows_and_by_columns_where_these_share_an_axis():
    by_rows = domains(stack_columns(drawn(2, 2))["layout"], "y")
    assert by_rows == sorted(by_rows, reverse=True)  # first row, left to right, then the second
    linked = domains(stack_columns(drawn(2, 2, shared_xaxes=True))["layout"], "y")
    assert [linked[i] for i in (0, 2, 1, 3)] == sorted(linked, reverse=True)


def test_titles_go_with_their_pictures_and_a_shared_axis_is_labelled_everywhere():
    figure = drawn(1, 2, shared_yaxes=True, subplot_titles=["one", "two"])
    figure["layout"]["yaxis"]["title"] = {"text": "force (N)"}
    layout = stack_columns(figure)["layout"]
    tops = [layout[name]["domain"][1] for name in ("yaxis", "yaxis2")]
    assert [a["y"] for a in layout["annotations"]] == pytest.approx(tops)
    assert layout["yaxis2"]["showticklabels"]
    assert layout["yaxis2"]["title"]["text"] == "force (N)"


def test_a_figure_of_one_column_keeps_its_pictures_and_wraps_long_titles():
    figure = drawn(2, 1)
    assert stack_columns(figure) is figure
    figure["layout"]["xaxis"]["title"] = {"text": "backward whirl, frequency (Hz), forward whirl"}
    title = fit_narrow(figure)["layout"]["xaxis"]["title"]["text"]
    assert title == "backward whirl, frequency (Hz),<br>forward whirl"
    assert "<br>" not in figure["layout"]["xaxis"]["title"]["text"]  # what is drawn wide
