"""Programs that take part in the public benchmark: ours, and those of others beside it.

``python -m benchmarks.peers NAME --data DIR --out RESULTS`` answers the tasks of a benchmark by one
program, in the files that ``standoff benchmark score`` reads. No program is given anything of the
folder ``truth``.
"""
