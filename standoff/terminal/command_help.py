"""What the help of a command shows besides its docstring: examples."""

from itertools import groupby

_EXAMPLES = """\
standoff demo --out demo-output
standoff capture --bench bench.toml --plan plan.toml --out session --dry-run
standoff capture --bench bench.toml --plan plan.toml --out session
standoff session show session
standoff session exclude 7 session --reason "a hair on the target"
standoff verify session
standoff import edge-*.tif --kind edge --height-mm 250 --out session
standoff export session --format ome-tiff --out session.ome.tif
standoff export session --format nexus --out session.nxs --geometry geometry.json
standoff calibrate edge-*.tif --out psf.json --report psf.html
standoff calibrate --session session --out session/results/psf.json
standoff compare before.json after.json
standoff compare --history lens-files --report history.html
standoff focus --bench bench.toml
standoff focus --bench bench.toml --sweep --from 280 --to 330 --out focus.png
standoff geometry --session session --out geometry.json
standoff noise --session session --out noise.json --report noise.html
standoff simulate near.tif --zoom 2 --psf psf.json --out far.tif
standoff simulate near.tif --homography H.json --psf psf.json --out tilted.tif
standoff sr-pairs photographs --psf psf.json --zoom 2 --out pairs
standoff change-pairs photographs --psf psf.json --zooms 1,2.5 --noise 1,4 --out pairs
standoff plan-study --bench bench.toml --plan plan.toml --psf psf.json --want sigma=0.5%
standoff detectability photographs --psf psf.json --noise 2 --contrast 12 --out curves.json
standoff evaluate ssim --photographs scenes --psf psf.json --noise 2 --contrast 12 \
--out evaluation.json --report evaluation.html
standoff evaluate "python detect.py {reference} {followup} {out}" --photographs scenes \
--psf psf.json --out evaluation.json
standoff limits --curves curves.json --min-dprime 2 --geometry geometry.json
standoff limits --curves curves.json --min-dprime 2 --focal-length-px 964 --image-size 780x580
standoff pose before.tif after.tif --curves curves.json --min-dprime 2
standoff pose before.tif --bench bench.toml --curves curves.json --min-dprime 2
standoff changes before.tif after.tif --out changes
standoff changes before after --out changes --workers 4
standoff validate --session session --psf psf.json --out validation \
--models bicubic,paper,matched,lmmse
standoff paper --short --out paper-output
standoff report session
standoff benchmark make --out benchmark --size small --workers 2
standoff benchmark score mine theirs --data benchmark --out scores
standoff console --bench bench.toml
standoff mock --stage-protocol grbl
standoff doctor --bench bench.toml
standoff cameras
standoff stage home --bench bench.toml
standoff stage move 250 --bench bench.toml
"""

EXAMPLES = {
    name: tuple(lines)
    for name, lines in groupby(_EXAMPLES.splitlines(), key=lambda line: line.split()[1])
}
"""Command lines that show how a command is used; the names of files are the reader's."""


def examples_text(name: str) -> str:
    """The examples of a command, one a line, to stand at the end of its help."""
    shown = EXAMPLES[name]
    title = "Example:" if len(shown) == 1 else "Examples:"
    return "\n".join([title, *(f"  {line}" for line in shown)])
