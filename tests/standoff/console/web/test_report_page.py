"""Which scripts of a result's page run in the console, and what a page says whose does not."""

from base64 import b64encode
from hashlib import sha256

import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")

from analysis.reports import views_script
from standoff.console.web.report_page import (
    BLOCKED,
    REPORT_POLICY,
    has_foreign_script,
    report_response,
)
from tests.analysis.reports.test_changes import page

OTHER = b"<body class=x><script>steal()</script></body>"


def test_the_policy_names_the_script_that_a_report_of_changes_has_and_no_other() -> None:
    document, _ = page()
    begin = document.index("<script>") + len("<script>")
    script = document[begin : document.index("</script>")]
    assert script == views_script()
    assert f"'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'" in REPORT_POLICY
    assert "unsafe-inline'; img" in REPORT_POLICY  # of styles
    assert REPORT_POLICY.count("script-src") == 1
    assert "allow-same-origin" not in REPORT_POLICY
    assert not has_foreign_script(document.encode())


@pytest.mark.parametrize(
    "document",
    [
        OTHER,
        b"<SCRIPT src=x.js></SCRIPT >",
        b"<body><script>" + views_script().encode()[:-9] + b"</script>",
    ],
)
def test_a_page_whose_script_does_not_run_says_so_at_its_top(document: bytes) -> None:
    assert has_foreign_script(document)
    answer = bytes(report_response(document).body)
    assert answer.replace(BLOCKED.encode(), b"") == document
    assert answer.index(b"does not run in the console") < answer.lower().index(b"<script")


def test_a_page_without_a_script_is_served_as_it_is() -> None:
    plain = b"<!doctype html><body>a report</body>"
    answer = report_response(plain)
    assert bytes(answer.body) == plain
    assert answer.headers["Content-Security-Policy"] == REPORT_POLICY
