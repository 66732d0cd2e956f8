#!/usr/bin/env bash
# Statements and branches that the tests reach: at least 90 % of every package.
set -euo pipefail
cd "$(dirname "$0")/.."
python=.venv/bin/python
export OPENBLAS_NUM_THREADS=1

$python -m pytest -n 2 -m "not slow" --cov --cov-report=
$python -m pytest -n 2 -m slow --cov --cov-append --cov-report=

# What numba compiles cannot be watched: tests of it that are short enough run once more,
# interpreted. Left out are those of many fits or whole images, two of sums that overflow there, as
# numpy's scalars keep their type, and one that the last bit decides.
left_out="repeated_fits or shot_noise_is_weighted or sigma_depends_on_neither"
left_out="$left_out or order_of_the_frames or largest_levels_do_not_overflow"
left_out="$left_out or as_sharp_as_the_pixel_alone"
NUMBA_DISABLE_JIT=1 $python -m pytest -n 2 -m "not slow" -k "not ($left_out)" \
    --cov --cov-append --cov-report= \
    tests/acquisition/{test_averaging,focus/test_measures,aravis/test_stream}.py \
    tests/calibration/edges/test_{detection,segments,esfr,fit,penalised_spline,residuals,samples}.py \
    tests/hil_mocks/scene/test_render.py tests/simulation/test_resampling.py
NUMBA_DISABLE_JIT=1 $python -m pytest -n 2 --cov --cov-append --cov-report= \
    tests/simulation/pose/test_warp.py tests/simulation/pose/test_simulate.py \
    -k "definition or derivative or a_ramp_keeps or outside_and_zero or indefinite_blur"

for package in acquisition calibration simulation analysis hil_mocks standoff; do
    echo "== $package"
    $python -m coverage report --include="$package/*" --skip-covered --fail-under=90
done
echo "== all"
$python -m coverage report --format=total
