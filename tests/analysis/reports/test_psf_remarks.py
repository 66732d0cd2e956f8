"""What is said of a calibration whose edges are those of a scene, and not of a target."""

from analysis.reports import psf_remarks
from calibration.edges import EdgeMeasurement
from calibration.psf import PsfCalibration
from tests.calibration.sharpness.edges import edge_of


def edges(used: int, uneven: int, beside: int = 0) -> tuple[EdgeMeasurement, ...]:
    flags = [()] * used + [("uneven",)] * uneven + [("beside_target",)] * beside
    return tuple(edge_of(flags=each) for each in flags)


def said(given: tuple[EdgeMeasurement, ...]) -> str:
    return " ".join(psf_remarks(PsfCalibration(edges=given)))


def test_few_clean_edges_among_many_are_those_of_a_scene() -> None:
    text = said(edges(3, 42))
    assert "only 3 of the 45 edges found can be used" in text
    assert "--method two-distance" in text
    assert "--method single-image" in text


def test_the_edges_of_a_target_are_taken_for_none_of_a_scene() -> None:
    for given in (edges(20, 10), edges(4, 0), edges(20, 10, beside=80), ()):
        assert "edges found can be used" not in said(given)
