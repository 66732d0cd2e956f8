"""Words about commands: the examples of their help, and what other programs call what they do."""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
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
standoff lens edge-*.tif --dark darks --flat flats --out lens.html --customer "Muster AG"
standoff lens --session session --out lens.html --limits limits.toml
standoff simulate near.tif --zoom 2 --psf psf.json --out far.tif
standoff simulate near.tif --homography H.json --psf psf.json --out tilted.tif
standoff simulate near.tif --zoom 2 --depth depth.tif --psf psf.json --out far.tif
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
standoff guide before.jpg --out guided
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


_WORDS = {
    "calibrate": "mtf mtf50 sfr esfr e-sfr psf esf lsf otf sharpness sharp resolution resolve blur "
    "edge slanted slanted-edge iso12233 iso-12233 chart sfrmat fwhm optics lens-test kernel "
    "aberration chromatic chromatic-aberration lateral lateral-chromatic-aberration "
    "lateral-colour lateral-color lca ca colour-fringe colour-shift astigmatism field measure",
    "lens": "lens-report datasheet data-sheet test-report certificate neq noise-equivalent-quanta "
    "information information-capacity shannon overshoot undershoot sharpening mtf50p mtf20 mtf10 "
    "rise edge-rise imatest",
    "compare": "drift trend history decentring stability compare-psf",
    "focus": "autofocus defocus sweep focus-sweep through-focus depth-of-field dof live",
    "geometry": "distortion magnification scale px-per-mm pupil entrance-pupil intrinsics "
    "checkerboard chessboard charuco squareness camera-calibration",
    "noise": "gain dark flat darks-flats emva emva1288 emva-1288 prnu dsnu ptc photon-transfer "
    "conversion-gain read-noise linearity saturation full-well snr defect hot-pixel correction",
    "simulate": "zoom zoom-out downsample downscale resample resize shrink degrade distance "
    "further farther degradation synthesize render forward",
    "changes": "diff difference differ subtract subtraction change detect detection anomaly "
    "compare-photographs compare-images compare-pictures defects moved",
    "pose": "align alignment register registration registration-error warp homography match "
    "overlay go-no-go tilt",
    "limits": "limit tolerance how-far allowed maximum max-distance budget",
    "detectability": "dprime d-prime d' detectable visibility sensitivity contrast "
    "contrast-threshold observer cho ideal-observer curve",
    "evaluate": "detector roc auc score test-detector benchmark-detector false-alarm recall",
    "change-pairs": "training dataset data-set augment synthetic",
    "sr-pairs": "super-resolution superresolution sr crop kernelgan",
    "plan-study": "power sample-size precision uncertainty study predict design",
    "validate": "validation accuracy model prediction tables",
    "capture": "acquire acquisition grab snap shoot record scan take photograph timelapse run "
    "dry-run resume plan",
    "session": "exclude include note retake captures",
    "verify": "checksum hash sha256 integrity audit fsck",
    "import": "load ingest add",
    "export": "convert save ome-tiff ome-zarr nexus hdf5 zarr",
    "report": "html pdf summary protocol",
    "console": "gui ui web server serve browser dashboard operator start",
    "guide": "phone mobile smartphone qr guidance",
    "mock": "simulator emulator fake practice simulated-bench virtual",
    "doctor": "check diagnose diagnostics selftest self-test health test troubleshoot setup info",
    "cameras": "camera discover list-cameras gige arv-tool devices ls list",
    "stage": "move home homing jog grbl zaber axis height unlock stop motor",
    "demo": "example tour tutorial quickstart try",
    "paper": "reproduce replicate",
    "benchmark": "leaderboard challenge",
    "--help": "help usage man commands",
    "--version": "version about",
    "session list": "sessions",
    "session show": "show",
}
_OF_GROUPS = {
    "session": {
        "list": "ls dir",
        "show": "info status print cat",
        "exclude": "remove delete rm drop reject",
        "include": "restore undo add accept",
        "note": "comment remark annotate",
        "set-height": "height correct-height",
    },
    "benchmark": {
        "make": "create generate download build",
        "score": "run evaluate test",
    },
}
_ALIKE = 0.8
"""Similarity from which a misspelt word is taken for one of these."""


def _by_word(words: Mapping[str, str]) -> dict[str, str]:
    return {word: command for command, text in words.items() for word in text.split()}


def meant_command(word: str, group: str, commands: Iterable[str]) -> str | None:
    """Return the command, perhaps with an option, that a word means in a group; None if none is.

    ``lens report`` and ``lens_report`` are one word; the group of the application is ``standoff``.
    """
    meant = _by_word(_OF_GROUPS.get(group, {}) if group != "standoff" else _WORDS)
    meant = {**meant, **{name: name for name in commands}}
    spelt = "-".join(word.casefold().replace("_", " ").replace("-", " ").split())
    singular = spelt.removesuffix("s")
    for each in (spelt, singular, f"{spelt}s"):
        if each in meant:
            return meant[each]
    alike = get_close_matches(spelt, meant, n=1, cutoff=_ALIKE)
    return meant[alike[0]] if alike else None
