from standoff.console.jobs.control_arbiter import ControlArbiter


def test_the_first_page_is_in_control_and_the_second_watches() -> None:
    arbiter = ControlArbiter()
    arbiter.join("one", "Ada")
    arbiter.join("two", "Ben")
    assert arbiter.is_holder("one")
    assert not arbiter.is_holder("two")
    assert arbiter.view("two").holder == "Ada"
    assert arbiter.view("two").viewers == 2


def test_control_is_taken_over_only_by_who_is_there() -> None:
    arbiter = ControlArbiter()
    arbiter.join("one", "Ada")
    arbiter.take("two")
    assert arbiter.is_holder("one")
    arbiter.join("two", "Ben")
    arbiter.take("two")
    assert arbiter.is_holder("two")
    assert arbiter.operator() == "Ben"


def test_a_lost_page_keeps_control_until_somebody_takes_it() -> None:
    arbiter = ControlArbiter()
    arbiter.join("one", "Ada")
    arbiter.leave("one")
    arbiter.join("two", "Ben")
    assert arbiter.view("two").is_away
    assert not arbiter.is_holder("two")
    arbiter.join("one", "Ada")
    assert arbiter.view("one").is_mine


def test_who_gives_control_away_leaves_it_to_the_next() -> None:
    arbiter = ControlArbiter()
    arbiter.join("one", "Ada")
    arbiter.release("two")
    assert arbiter.is_holder("one")
    arbiter.release("one")
    assert arbiter.view("one").holder == ""
    arbiter.join("two", "Ben")
    assert arbiter.is_holder("two")
