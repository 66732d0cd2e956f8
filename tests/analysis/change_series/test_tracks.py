"""Tracks of changes over follow-ups: closed form, with lists and readings made up by hand."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import permutations

import pytest
from hypothesis import given, strategies as st

from analysis.change_series import PlaceReading, track_changes
from analysis.changes import Change
from tests.analysis.changes.compared_fields import change_at

ZOOM = 2.0


def change(x: float, y: float, amplitude_dn: float, significance: float = 10.0) -> Change:
    """A change at a place of the reference, seen from twice as far."""
    return change_at(
        x / ZOOM,
        y / ZOOM,
        amplitude_dn,
        reference_x_px=x,
        reference_y_px=y,
        amplitude_err_dn=abs(amplitude_dn) / significance,
        significance=significance,
    )


@dataclass(frozen=True)
class Followup:
    """One whose maps say nothing but at a few places of the follow-up."""

    changes: tuple[Change, ...] = ()
    readings: Mapping[tuple[float, float], PlaceReading] = field(default_factory=dict)
    zoom: float = ZOOM

    def place_of(self, reference_x_px: float, reference_y_px: float) -> tuple[float, float]:
        return reference_x_px / self.zoom, reference_y_px / self.zoom

    def reading_at(self, x_px: float, y_px: float) -> PlaceReading | None:
        return self.readings.get((x_px, y_px))


def test_a_change_that_stays_is_one_track_at_the_weighted_mean_of_its_places() -> None:
    (track,) = track_changes(
        [Followup((change(100, 60, 8.0, 10.0),)), Followup((change(103, 60, 9.0, 20.0),))]
    )
    # Weights 100 and 400.
    assert track.reference_x_px == pytest.approx(102.4)
    assert track.reference_y_px == 60
    assert (track.first_seen, track.last_seen, track.seen) == (0, 1, 2)
    assert [point.amplitude_dn for point in track.points] == [8.0, 9.0]


def test_a_change_of_the_other_sign_at_the_same_place_is_another_track() -> None:
    tracks = track_changes([Followup((change(100, 60, 8.0),)), Followup((change(100, 60, -8.0),))])
    assert len(tracks) == 2
    assert all(track.seen == 1 for track in tracks)


def test_places_further_apart_than_both_can_scatter_are_two_tracks() -> None:
    # 4 sqrt(2) 0.5 px of the coarser photograph, which are 2 px of the reference each.
    for apart, count in ((5.6, 1), (5.7, 2)):
        lists = (change(100, 60, 8.0),), (change(100 + apart, 60, 8.0),)
        assert len(track_changes([Followup(each) for each in lists])) == count


def test_something_extended_is_one_track_wherever_in_it_the_strongest_place_lies() -> None:
    wide = change(115, 60, 8.0).model_copy(update={"area_px": 200.0})  # a radius of 16 px
    assert len(track_changes([Followup((change(100, 60, 8.0),)), Followup((wide,))])) == 1


def test_of_two_that_could_continue_a_track_the_nearer_one_does() -> None:
    second = change(104, 60, 7.0), change(101, 60, 6.0)
    tracks = track_changes([Followup((change(100, 60, 8.0),)), Followup(second)])
    assert len(tracks) == 2
    assert [point.amplitude_dn for point in tracks[0].points] == [8.0, 6.0]
    assert tracks[1].first_seen == 1


def test_where_it_is_not_seen_the_limit_is_for_a_change_of_its_own_shape() -> None:
    place = (50.0, 30.0)
    # Its peak is 20 DN and the smoothed difference there 10 * 1 DN: twice of it.
    seen = Followup((change(100, 60, 20.0),), {place: PlaceReading(10.0, 1.0)})
    weak = Followup((), {place: PlaceReading(1.5, 2.0)})
    against = Followup((), {place: PlaceReading(-1.5, 2.0)})
    (track,) = track_changes([seen, weak, against, Followup()])
    _, beside, below, unseen = track.points
    assert beside.sighting == "not seen"
    assert beside.amplitude_err_dn == pytest.approx(4.0)
    assert beside.amplitude_dn == pytest.approx(6.0)
    assert beside.upper_limit_dn == pytest.approx(6.0 + 1.645 * 4.0)
    # What goes the other way leaves no room for it: the limit is that of the noise.
    assert below.amplitude_dn == pytest.approx(-6.0)
    assert below.upper_limit_dn == pytest.approx(1.645 * 4.0)
    assert unseen.sighting == "not compared"
    assert unseen.upper_limit_dn is None
    assert (beside.x_px, beside.y_px) == place


def test_a_limit_of_something_darker_counts_what_is_darker() -> None:
    place = (50.0, 30.0)
    seen = Followup((change(100, 60, -20.0),), {place: PlaceReading(-10.0, 2.0)})
    (track,) = track_changes([seen, Followup((), {place: PlaceReading(-1.0, 2.0)})])
    assert track.points[1].amplitude_dn == pytest.approx(-2.0)
    assert track.points[1].upper_limit_dn == pytest.approx(2.0 + 1.645 * 2.0)


def test_no_follow_up_and_no_change_make_no_track() -> None:
    assert track_changes([]) == ()
    assert track_changes([Followup(), Followup()]) == ()


@pytest.mark.slow
@given(
    st.lists(
        st.lists(
            st.tuples(st.integers(0, 4), st.integers(0, 4), st.sampled_from([-9.0, 9.0])),
            max_size=6,
            unique=True,
        ),
        max_size=5,
    )
)
def test_every_change_is_in_one_track_and_a_track_has_one_of_a_follow_up(
    listed: list[list[tuple[int, int, float]]],
) -> None:
    # Places 3 px apart: several are within reach of each other.
    followups = [Followup(tuple(change(3 * x, 3 * y, a) for x, y, a in one)) for one in listed]
    tracks = track_changes(followups)
    for number, followup in enumerate(followups):
        points = [track.points[number] for track in tracks]
        seen = [(p.x_px, p.y_px, p.amplitude_dn) for p in points if p.sighting == "seen"]
        own = [(c.x_px, c.y_px, c.amplitude_dn) for c in followup.changes]
        assert sorted(seen) == sorted(own)
    for track in tracks:
        signs = {p.amplitude_dn > 0 for p in track.points if p.amplitude_dn is not None}
        assert len(signs) == 1
        assert len(track.points) == len(followups)


def test_the_order_of_a_list_does_not_matter() -> None:
    second = (change(104, 60, 7.0), change(101, 60, 6.0), change(99, 64, 5.0))
    first = Followup((change(100, 60, 8.0), change(100, 66, 8.0)))
    told = {track_changes([first, Followup(tuple(one))]) for one in permutations(second)}
    assert len(told) == 1
