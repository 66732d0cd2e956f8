from tests.fuzz.commands.search import SearchedPart, parts_in


def test_what_a_run_printed_tells_what_it_has_done() -> None:
    done = (
        SearchedPart(slot="pose --psf", first=0, cases=40, faults=("empty, empty: status 70",)),
        SearchedPart(slot="verify, journal.jsonl", first=200, cases=21, faults=()),
    )
    printed = "\n".join(["note: 2 captures", str(done[0]), "  pose --psf: empty: a", str(done[1])])
    assert parts_in(printed) == {("pose --psf", 0), ("verify, journal.jsonl", 200)}
