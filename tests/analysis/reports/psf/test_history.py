from analysis.reports.psf.history import (
    history_document,
    history_sections,
    ordered_history,
    plot_history,
)
from calibration.psf import PsfCalibration


def psf(sigma_x_px: float, captured_utc: str | None, serial: str | None = "A7") -> PsfCalibration:
    return PsfCalibration.model_validate(
        {
            "sigma_x_px": sigma_x_px,
            "sigma_x_err_px": 0.002,
            "sigma_y_px": 0.7,
            "sigma_y_err_px": 0.002,
            "camera": {"serial": serial},
            "captured_utc": captured_utc,
        }
    )


HISTORY = (
    ("later.json", psf(0.85, "2025-05-02T08:00:00.000000Z")),
    ("other.json", psf(0.60, "2025-03-01T08:00:00.000000Z", "B1")),
    ("first.json", psf(0.80, "2025-03-04T08:00:00.000000Z")),
    ("photo.json", psf(0.80, None, None)),
)


def test_calibrations_stand_by_camera_and_time_each_against_the_first() -> None:
    history = ordered_history(HISTORY)
    assert list(history) == ["A7", "B1", "unknown"]
    first, later = history["A7"]
    assert (first.name, first.verdict) == ("first.json", "")
    assert later.verdict.startswith("the PSF has changed: sigma_x_px by +6.25 %")
    document = history_document(history)
    assert document["cameras"][0]["calibrations"][1]["change"] == later.verdict


def test_a_camera_has_a_table_and_from_two_times_on_a_figure() -> None:
    known, lone, unknown = history_sections(ordered_history(HISTORY))
    assert known.title == "Camera A7"
    # 1.96 times the standard error of 0.002.
    assert known.tables[0].rows[0][:3] == ("first.json", "2025-03-04 08:00:00", "0.8000 ± 0.0039")
    assert len(known.figures) == 1
    assert lone.figures == unknown.figures == ()
    assert unknown.tables[0].rows[0][1] == "unknown"


def test_widths_are_drawn_with_their_intervals() -> None:
    figure = plot_history(ordered_history(HISTORY)["A7"])
    assert figure is not None
    assert len(figure.axes[0].containers) == 2
    assert figure.axes[0].get_ylabel() == "total sigma / px"


def test_what_cannot_be_compared_says_so() -> None:
    bare = PsfCalibration.model_validate({"sigma_x_px": 0.8, "camera": {"serial": "A7"}})
    [_, second] = ordered_history([("a", bare), ("b", bare)])["A7"]
    assert second.verdict.startswith("not comparable: no width in common")


def test_a_width_that_no_calibration_has_is_not_drawn() -> None:
    lone = [
        (name, one.model_copy(update={"sigma_y_px": None, "sigma_y_err_px": None}))
        for name, one in (HISTORY[0], HISTORY[2])
    ]
    figure = plot_history(ordered_history(lone)["A7"])
    assert figure is not None
    [axes] = figure.axes
    assert len(axes.containers) == 1
