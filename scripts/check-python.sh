#!/bin/sh
# Name in one line what is missing before a virtual environment can be made.
set -eu
python=${1:-python3}
if ! command -v "$python" >/dev/null 2>&1; then
    echo "standoff needs Python 3.11 or newer: install python3 and python3-venv" >&2
    exit 1
fi
if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
    echo "standoff needs Python 3.11 or newer, $("$python" --version) is here: name one with PYTHON=" >&2
    exit 1
fi
if ! "$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then
    echo "standoff needs Python's venv module: install python3-venv" >&2
    exit 1
fi
