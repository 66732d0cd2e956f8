import numpy as np
from hypothesis import given, settings, strategies as st

from analysis.reports.psf_edges import LABEL_POINTS, placed_labels, plot_edges
from tests.calibration.sharpness.edges import edge_of

WIDTH_PX, HEIGHT_PX, PX_PER_IN = 640, 480, 100.0
PLACES = st.lists(
    st.tuples(st.floats(0, WIDTH_PX), st.floats(0, HEIGHT_PX), st.floats(0.1, 0.4)),
    min_size=2,
    max_size=80,
)


@settings(max_examples=60)
@given(places=PLACES)
def test_no_two_labels_overlap_and_none_leaves_the_photograph(
    places: list[tuple[float, float, float]],
) -> None:
    edges = [edge_of(x_px=x, y_px=y, mtf50_cy_per_px=mtf50) for x, y, mtf50 in places]
    labels = placed_labels(edges, WIDTH_PX, HEIGHT_PX, PX_PER_IN)
    # Five letters of half their size at least, one line high.
    width, height = 5 * 0.5 * LABEL_POINTS / 72 * PX_PER_IN, LABEL_POINTS / 72 * PX_PER_IN
    for k, one in enumerate(labels):
        assert width / 2 <= one.x_px <= WIDTH_PX - width / 2
        assert height / 2 <= one.y_px <= HEIGHT_PX - height / 2
        for other in labels[:k]:
            assert abs(one.x_px - other.x_px) >= width or abs(one.y_px - other.y_px) >= height


def test_where_labels_are_thinned_those_of_the_extremes_stay() -> None:
    grid = [(20.0 + 6 * i, 20.0 + 6 * k) for i in range(90) for k in range(70)]
    edges = [edge_of(x_px=x, y_px=y, mtf50_cy_per_px=0.25) for x, y in grid[::7]]
    edges[40] = edge_of(x_px=300.0, y_px=200.0, mtf50_cy_per_px=0.111)
    edges[50] = edge_of(x_px=100.0, y_px=300.0, mtf50_cy_per_px=0.444)
    texts = [label.text for label in placed_labels(edges, WIDTH_PX, HEIGHT_PX, PX_PER_IN)]
    assert texts[:2] == ["0.111", "0.444"]
    assert 20 < len(texts) <= 70


def test_labels_on_the_photograph_are_of_8_points_and_not_of_rejected_edges() -> None:
    edges = [
        edge_of(x_px=50.0, y_px=40.0, mtf50_cy_per_px=0.222),
        edge_of(x_px=150.0, y_px=140.0, mtf50_cy_per_px=0.333, flags=["saturated"]),
    ]
    figure = plot_edges(np.eye(200, 240), edges, frozenset({"saturated"}), 7.2)
    texts = figure.axes[0].texts
    assert [text.get_text() for text in texts] == ["0.222"]
    assert texts[0].get_fontsize() == 8.0
