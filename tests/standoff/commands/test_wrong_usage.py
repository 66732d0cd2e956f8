"""Wrong usage of every command: status 2, one line that says what is wrong, and nothing written."""

from pathlib import Path

import numpy as np
import pytest
import tifffile

from analysis.detectability import DetectabilityCurves
from analysis.results_file import write_results
from calibration.files import write_homography
from calibration.registration import Homography
from tests.analysis.detectability.test_curves import curve
from tests.calibration.closed_form import edge_image
from tests.calibration.registration.test_tracking import scene
from tests.standoff.changed_photographs import write_psf
from tests.standoff.conftest import SMALL_BENCH, SMALL_PLAN, TEXTURE, Command

LIMITS = "limits --curves curves.json --min-dprime 3"
CAMERA = "--focal-length-px 800 --image-size 640x480"
POSE = "--curves curves.json --observer npw --min-dprime 3.2"
NOISE_AND_MAPS = "--noise and --correct apply to linear grey levels"

WRONG: dict[str, tuple[tuple[str, str], ...]] = {
    "calibrate edge.tif --out p.json": (
        ("--pixel-pitch-um -5", "must be positive"),
        ("--pixel-pitch-um 0", "pixel_pitch_um"),
        ("--pixel-pitch-um 0.005", "millimetres"),
        ("--pixel-pitch-um 4,5", "4.5"),
        ("--bayer RGGB --channel luma", "a mosaic has red, green and blue"),
        ("--bayer RGGB --srgb", "raw mosaics are linear"),
        ("--bayer RGBG", "RGBG"),
        ("--method guess", "guess"),
        ("--report page.txt", "must end in"),
        ("--region left", "expected centre or X,Y,W,H in px, got left"),
        ("--srgb --noise noise.json", NOISE_AND_MAPS),
        ("--srgb --correct noise.json", NOISE_AND_MAPS),
        ("--csv e.xlsx", "e.xlsx must end in .csv"),
        ("--report r.png", "r.png must end in .htm or .html or .pdf"),
        ("--zoom 2", "--zoom needs --method two-distance"),
        ("--method two-distance", "two-distance needs at least two photographs"),
        ("--method single-image --bayer RGGB", "--bayer needs --method all-angles or paper"),
        ("--method single-image --limits l.toml", "--limits needs --method all-angles or paper"),
        *((f"--encoding '{name}'", "gamma:2.2") for name in ("sRGB", "gamma:0", "log", "")),
        ("--encoding gamma:nan", "gamma:2.2"),
    ),
    "calibrate edge.tif near.tif --method two-distance --out p.json": (
        ("--zoom 0.5", "a zoom-out must be a number of at least 1"),
        ("--report r.html", "--report needs --method all-angles or paper"),
        ("--zoom 2 --region 1,2", "expected centre or X,Y,W,H in px, got 1,2"),
    ),
    "calibrate edge.tif near.tif far.tif --method two-distance --zoom 2 --out p.json": (
        ("", "the distance ratio needs exactly two photographs"),
    ),
    "calibrate": (
        ("edge.tif --out p.png", "p.png must end in .json"),
        ("--session session --srgb --out p.json", "captures are linear and grey"),
    ),
    "changes near.tif far.tif --out out": (
        ("--expect-zoom 2 --points p.csv", "--expect-zoom cannot be used with --points"),
        ("--homography h --points p", "--homography cannot be used with --points"),
        ("--expect-zoom 0", "--expect-zoom"),
        ("--transfer measured", "--transfer needs --psf"),
        ("--false-discovery-rate 0.1 --false-alarms 1", "cannot be used with"),
        ("--false-discovery-rate 0.9", "--false-discovery-rate"),
        ("--white-level 0", "--white-level"),
        ("--report r", "must end in"),
    ),
    "compare": (
        ("psf.json", "give two psf.json files, got 1; or use --history"),
        ("psf.json psf.json psf.json", "give two psf.json files, got 3"),
        ("psf.json psf.json --report r.html", "--report needs --history"),
        ("--history psf.json --report r.png", "must end in"),
    ),
    "detectability near.tif --psf psf.json --out c.json": (
        ("--zooms 0.5", "numbers of at least 1, got 0.5"),
        ("--noise 0", "numbers above 0, got 0"),
        ("--noise x", "expected numbers, got x"),
        ("--zooms 1,25", "write 1.25"),
        ("--observer ideal", "'ideal' is not one of npw, hotelling, cho"),
        ("--model best", "'best' is not one of"),
        ("--window 16", "odd"),
        ("--signal-sigma 9", "exceeds the window"),
        ("--shard 3/2", "expected K/N with K from 1 to N"),
    ),
    "detectability near.tif --out c.json": (("", "needs --psf"),),
    "focus --bench bench.toml": (
        ("--region 100,0,100,90", "the region reaches beyond the frame"),
        ("--region 1,2,3", "expected X,Y,W,H"),
        ("--from 200", "--from needs"),
        ("--sweep --from 200", "--from needs --to"),
        ("--sweep --from 300 --to 200", "--from must be below --to"),
        ("--sweep --steps 4", "--steps"),
        ("--sweep --frames 1", "a sweep averages 2 frames or more"),
        ("--sweep --readings 5", "--readings is for the live aid"),
        ("--metric sharpness", "--metric"),
        ("--target nothing", "nothing"),
    ),
    "geometry --session session --out g.json": (
        ("--board eleven", "--board"),
        ("--scale -1", "--scale"),
        ("--focal-length-px nan", "--focal-length-px"),
    ),
    f"{LIMITS} {CAMERA}": (
        ("", "2 curves match; choose one with --observer (hotelling, npw)"),
        ("--observer cho", "no curve matches"),
        ("--observer npw --at-tilt 5", "--at-tilt needs --at-zoom"),
        ("--geometry g.json", "give exactly one of --geometry, --focal-length-px and --homography"),
        ("--min-dprime 0", "a threshold must be a number above 0"),
        ("--observer npw --aim 800,20", "must lie in the reference of 640 x 480 px"),
        ("--aim 20", "X,Y"),
        ("--aim nan,3", "numbers"),
        ("--criterion min", "--homography"),
        ("--reference-size 640x480", "--homography"),
    ),
    f"{LIMITS} --observer npw": (
        ("", "give exactly one of --geometry, --focal-length-px and --homography"),
        (
            "--focal-length-px 800 --image-size 640xabc",
            "--image-size must be WxH in px, such as 780x580, got 640xabc",
        ),
        ("--focal-length-px 800 --image-size 640", "--image-size must be WxH in px"),
        ("--focal-length-px -1 --image-size 640x480", "expected a number above 0"),
        ("--focal-length-px 8 --image-size 640x480", "divided by the pixel pitch"),
        ("--focal-length-px 800,5 --image-size 640x480", "write 800.5"),
        ("--focal-length-px '8 mm' --image-size 640x480", "'mm' is not one of its units"),
        ("--focal-length-px 800 --image-size 8x8", "a frame of 16 to 1,000,000 px a side"),
        ("--homography H.json --aim 20,30", "--aim needs"),
        ("--homography H.json --plot l.svg", "--plot needs"),
        ("--homography H.json --at-zoom 1.2", "--at-zoom needs"),
    ),
    "mock --bench bench.toml": (
        ("--address 192.0.2.1", "loopback"),
        ("--address camera", "not an IPv4 address"),
        ("--target moon", "no target 'moon'"),
        ("--orientation nan", "finite"),
    ),
    "lens edge.tif --out lens.html": (
        ("--dark darks", "--dark needs --flat"),
        ("--flat flats", "--flat needs --dark"),
        ("--noise noise.json --dark d --flat f", "--noise cannot be used with --dark or --flat"),
        ("--region left", "expected centre or X,Y,W,H in px, got left"),
        ("--session session", "give exactly one of"),
        ("--pixel-pitch-um 0", "pixel_pitch_um"),
    ),
    "lens --session session --out lens.html": (
        ("--leaves target.png", "a session shows edges, darks and flats"),
        ("--dark d --flat f", "a session has its own"),
        ("--bayer RGGB", "captures are linear and grey"),
    ),
    "lens edge.tif": (("--out lens.json", "must end in"),),
    "noise --session session": (("--out noise.txt", ".json"),),
    "plan-study --bench bench.toml --plan plan.toml --psf psf.json": (
        *(
            (f"--want {want}", "want")
            for want in ("sigma", "sigma=0.5", "blur=1%", "tilt=3%", "sigma=-1%", "sigma=nan%")
        ),
        ("--want dprime=0%", "want"),
        ("--levels 3", "--levels"),
        ("--levels 9,3", "--levels"),
        ("--contrast 0", "contrast"),
        ("--board 2x2:1:1", "--board"),
        ("--photographs near.tif", "128 a side are needed"),
    ),
    f"pose near.tif photographs {POSE}": (
        ("", "several follow-ups need --out DIR"),
        ("--out out --picture map.png", "a picture is written for a single follow-up only"),
        ("--out out --flat", "with several follow-ups, the scene is always treated as a plane"),
        ("--out out --shard 3/2", "expected K/N with K from 1 to N"),
        ("--out out --workers 2 --scheduler tcp://x:1", "not both"),
    ),
    f"pose near.tif far.tif {POSE}": (
        ("--shard 1/2", "--shard needs several follow-ups"),
        ("--scheduler tcp://x:1", "--scheduler needs several follow-ups"),
        ("--out out", "--out needs several follow-ups, or a folder of them"),
    ),
    f"pose near.tif {POSE}": (
        ("", "give exactly one of FOLLOWUP, --stream and --bench"),
        ("far.tif --frames 3", "--frames needs --stream or --bench"),
        ("far.tif --watch", "--watch needs --stream"),
        ("far.tif --target coins", "--target needs --bench"),
        ("--stream . --picture map.png", "--picture needs FOLLOWUP"),
        ("--stream . --flat", "--flat needs FOLLOWUP"),
    ),
    f"pose texture.tif {POSE}": (
        ("--stream no-such", "no-such is not a folder"),
        ("--bench bench.toml --target moon", "no target 'moon'"),
    ),
    f"pose near.tif --stream photographs {POSE}": (
        ("--expect-zoom 1.5", "--expect-zoom needs FOLLOWUP"),
    ),
    "simulate near.tif --zoom 2 --psf psf.json --out new.tif": (
        ("--sharpen much", "expected AMOUNT or AMOUNT,SIGMA_PX, got much"),
        ("--sharpen nan", "sharpening"),
        ("--sharpen 0.8,0", "sharpening"),
        ("--sharpen 0,8", "write 0.8 with a decimal point"),
        ("--exposure inf", "exposure"),
        ("--vignetting 3", "vignetting"),
        ("--seed -1", "--seed"),
        ("--out new.png", "new.png must end in"),
        ("--homography H.json", "give exactly one of --zoom and --homography"),
        ("--nearer mask.png", "--nearer needs --homography"),
        ("--model matched --steps 5", "--steps needs --model"),
        ("--model kernelgan", "--psf needs --model"),
        ("--uncertainty err.tif --sharpen 0.5", "sharpening"),
        ("--uncertainty err.tif --reference-noise -1", "negative"),
    ),
    "simulate near.tif --psf psf.json --out new.tif": (
        ("", "give exactly one of --zoom and --homography"),
        ("--homography H.json --model paper", "--homography needs --model"),
    ),
    "simulate near.tif --zoom 2 --out new.tif": (
        ("--model bicubic --uncertainty err.tif", "--uncertainty"),
        ("--model bicubic --sampler nearest", "--sampler needs --model"),
        ("--model bicubic --centre-crop", "--centre-crop needs --model"),
        ("--model bicubic --kernel-cache k", "--kernel-cache needs --model"),
        ("--model kernelgan --steps 0", "--steps"),
    ),
    "stage --bench bench.toml": (
        ("move", "move takes one height in mm"),
        ("home 5", "move takes one height in mm"),
        ("fly", "fly"),
        ("home --home", "--home is for move only"),
        ("move high", "[MM]"),
        ("status --set stage.speed=3", "stage.speed"),
    ),
    "validate --session session --psf psf.json --out v": (
        ("--models sharper", "unknown model 'sharper'; the models are bicubic, kernelgan"),
        ("--models paper --steps 9", "need a learned model"),
        ("--references 0", "--references"),
        ("--workers 0", "--workers"),
    ),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, captured_session: Path) -> Path:
    """Files that commands would read, were they asked rightly."""
    path = tmp_path_factory.mktemp("usage")
    (path / "session").symlink_to(captured_session)
    (path / "photographs").mkdir()
    tifffile.imwrite(path / "edge.tif", np.rint(edge_image(0.8, 5.0)).astype(np.uint16))
    for name in ("near.tif", "far.tif", "photographs/1.tif", "photographs/2.tif"):
        tifffile.imwrite(path / name, TEXTURE)
    tifffile.imwrite(path / "texture.tif", scene().astype(np.float32))
    write_psf(path / "psf.json")
    write_homography(path / "H.json", Homography(matrix=np.eye(3), size=(91, 60)))
    curves = DetectabilityCurves(curves=[curve(), curve(observer="hotelling")])
    write_results(path / "curves.json", curves)
    (path / "bench.toml").write_text(SMALL_BENCH)
    (path / "plan.toml").write_text(SMALL_PLAN)
    return path


@pytest.mark.parametrize(
    ("line", "message"),
    [(f"{words} {more}", said) for words, cases in WRONG.items() for more, said in cases],
)
def test_it_is_one_line_and_nothing_is_written(
    command: Command, folder: Path, monkeypatch: pytest.MonkeyPatch, line: str, message: str
) -> None:
    monkeypatch.chdir(folder)
    before = sorted(folder.rglob("*"))
    err = command.refused(2, line)
    assert message in err
    assert err.count("\n") == 1
    assert sorted(folder.rglob("*")) == before
