#!/bin/sh
# What the full environment needs beside Python: installed where we may, else named in one line.
set -eu
packages="gcc pkg-config libgirepository1.0-dev libcairo2-dev gir1.2-aravis-0.8 libpangoft2-1.0-0"

# The console's tests look at it through a Chromium, where the system offers one as a package
# (Ubuntu does not), and a test opens a capture in ImageJ on a screen that is not there (Xvfb);
# without them they are skipped.
wanted="chromium imagej xvfb xauth"

[ "$(uname -s)" = Linux ] || exit 0

missing=""
for package in $packages; do
    dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' ||
        missing="$missing $package"
done
optional=""
for package in $wanted; do
    dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' ||
        optional="$optional $package"
done
[ -n "$missing$optional" ] || exit 0

if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
    apt-get update -qq
    for package in $optional; do
        # Ubuntu's transitional package is empty: its name says that a snap is meant.
        if apt-cache madison "$package" | grep -qv -i snap; then missing="$missing $package"; fi
    done
    [ -n "$missing" ] || exit 0
    echo "Installing system packages:$missing"
    # shellcheck disable=SC2086
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing >/dev/null
    exit 0
fi
if [ -n "$optional" ]; then
    echo "without$optional some tests are skipped: sudo apt-get install$optional" >&2
fi
[ -n "$missing" ] || exit 0
echo "the full environment needs these system packages: sudo apt-get install$missing" >&2
exit 1
