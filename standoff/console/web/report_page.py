"""A result's page as the console serves it: in a sandbox where only its own script runs."""

import re
from base64 import b64encode
from hashlib import sha256

from starlette.responses import Response

from analysis.reports import views_script

_SCRIPT_HASH = f"sha256-{b64encode(sha256(views_script().encode('utf-8')).digest()).decode()}"

REPORT_POLICY = (
    f"default-src 'none'; script-src '{_SCRIPT_HASH}'; style-src 'unsafe-inline'; img-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    "sandbox allow-scripts allow-popups"
)
"""One file that contains its styles and figures. Only that script runs which this version writes
into its reports, word for word, in an origin of its own that reaches nothing."""

_SCRIPTS = re.compile(rb"<script\b[^>]*>(.*?)</script", re.IGNORECASE | re.DOTALL)
_BODY = re.compile(rb"<body\b[^>]*>", re.IGNORECASE)

BLOCKED = (
    '<p role="alert" style="margin:0;padding:.7em 1em;background:#fff3cd;color:#3d2f00">'
    "<b>The script of this page does not run in the console</b>, as it is not of this version of "
    "standoff: rows cannot be chosen, and before and after do not blink. Compute the result again "
    "to have both, or open the file itself.</p>"
)


def report_response(page: bytes) -> Response:
    """Answer with a page of results; one whose script does not run says so at its top."""
    return Response(
        with_notice(page) if has_foreign_script(page) else page,
        media_type="text/html",
        headers={"Content-Security-Policy": REPORT_POLICY},
    )


def has_foreign_script(page: bytes) -> bool:
    """Whether a page has a script that the policy keeps from running."""
    own = views_script().encode("utf-8")
    # A browser reads line ends of either kind as one.
    return any(found.replace(b"\r\n", b"\n") != own for found in _SCRIPTS.findall(page))


def with_notice(page: bytes) -> bytes:
    """Say at the top of a page that its script does not run."""
    body = _BODY.search(page)
    at = 0 if body is None else body.end()
    return page[:at] + BLOCKED.encode("utf-8") + page[at:]
