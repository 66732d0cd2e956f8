from standoff.console.jobs.control_arbiter import ControlDesk


def test_the_first_page_is_in_control_and_the_second_watches() -> None:
    desk = ControlDesk()
    desk.join("one", "Ada")
    desk.join("two", "Ben")
    assert desk.is_holder("one")
    assert not desk.is_holder("two")
    assert desk.view("two").holder == "Ada"
    assert desk.view("two").viewers == 2


def test_control_is_taken_over_only_by_who_is_there() -> None:
    desk = ControlDesk()
    desk.join("one", "Ada")
    desk.take("two")
    assert desk.is_holder("one")
    desk.join("two", "Ben")
    desk.take("two")
    assert desk.is_holder("two")
    assert desk.operator() == "Ben"


def test_a_lost_page_keeps_control_until_somebody_takes_it() -> None:
    desk = ControlDesk()
    desk.join("one", "Ada")
    desk.leave("one")
    desk.join("two", "Ben")
    assert desk.view("two").is_away
    assert not desk.is_holder("two")
    desk.join("one", "Ada")
    assert desk.view("one").is_mine


def test_who_gives_control_away_leaves_it_to_the_next() -> None:
    desk = ControlDesk()
    desk.join("one", "Ada")
    desk.release("two")
    assert desk.is_holder("one")
    desk.release("one")
    assert desk.view("one").holder == ""
    desk.join("two", "Ben")
    assert desk.is_holder("two")
