#!/bin/sh
# What the full environment needs beside Python: installed where we may, else named in one line.
set -eu
packages="gcc pkg-config libgirepository1.0-dev libcairo2-dev gir1.2-aravis-0.8 libpangoft2-1.0-0"

[ "$(uname -s)" = Linux ] || exit 0

missing=""
for package in $packages; do
    dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' ||
        missing="$missing $package"
done
[ -n "$missing" ] || exit 0

if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
    echo "Installing system packages:$missing"
    apt-get update -qq
    # shellcheck disable=SC2086
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing >/dev/null
    exit 0
fi
echo "the full environment needs these system packages: sudo apt-get install$missing" >&2
exit 1
