"""Descriptions that take Aravis down: refused, and the process that opened the camera lives on."""

import io
import json
import random
import re
import select
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from math import inf, nan
from pathlib import Path

import pytest

from acquisition.aravis._camera import AravisCamera, probe_camera
from acquisition.aravis._configuration import _require_usable
from acquisition.aravis._description import LARGEST_BYTES
from acquisition.errors import CameraDescriptionError, CameraFeatureError, MissingFeatureError
from hil_mocks.gige._description import describe
from hil_mocks.gige._features import features_of
from hil_mocks.practice_bench import PracticeBench
from tests.acquisition.aravis.description_texts import (
    CIRCLES,
    HARMLESS,
    in_a_row,
    node,
    simulated,
    with_nodes,
    with_width,
)
from tests.acquisition.aravis_bench import camera_config, needs_aravis, opened
from tests.acquisition.fakes import SETTINGS
from tests.hil_mocks.gige_bench import gige_bench

pytestmark = needs_aravis

ROOT = Path(__file__).parents[3]
ANSWERS_WITHIN_S = 120.0
REFUSED = "CameraDescriptionError"


class Evaluator:
    """A process that opens cameras: `tests.acquisition.evaluate_descriptions`."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.acquisition.evaluate_descriptions"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # Aravis' own remarks
            text=True,
            cwd=ROOT,
        )

    @property
    def status(self) -> int | None:
        """None while it lives."""
        return self._process.poll()

    def tries(self, bench: PracticeBench, *features: str) -> str:
        """What comes of evaluating features, or of opening the camera as a capture does."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([bench.camera.address, *features]) + "\n")
        self._process.stdin.flush()
        ready, _, _ = select.select([self._process.stdout], [], [], ANSWERS_WITHIN_S)
        assert ready, "no answer"
        line = self._process.stdout.readline()
        if not line:
            return f"died with {self._process.wait()}"
        return str(json.loads(line))

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


@pytest.fixture(scope="module")
def _evaluators() -> Iterator[list[Evaluator]]:
    evaluators: list[Evaluator] = []
    yield evaluators
    for evaluator in evaluators:
        evaluator.close()


@pytest.fixture
def evaluator(_evaluators: list[Evaluator]) -> Evaluator:
    """One for all tests, as long as it lives."""
    if not _evaluators or _evaluators[-1].status is not None:
        _evaluators.append(Evaluator())
    return _evaluators[-1]


@pytest.fixture
def bench() -> Iterator[PracticeBench]:
    with gige_bench() as opened_bench:
        yield opened_bench


def chain(length: int) -> str:
    row = [f"N{place}" for place in range(length)]
    return "".join(
        node("Integer", name, f"<pValue>{after}</pValue>")
        for name, after in zip(row, [*row[1:], "WidthReg"], strict=True)
    )


def doubling(levels: int) -> str:
    knife = '<pVariable Name="V">{0}</pVariable><pVariable Name="W">{0}</pVariable>'
    row = [f"N{place}" for place in range(levels)]
    return "".join(
        node("IntSwissKnife", name, knife.format(after) + "<Formula>V + W</Formula>")
        for name, after in zip(row, [*row[1:], "WidthReg"], strict=True)
    )


def register(length: str) -> str:
    return node("IntReg", "N0", f"<Address>0xa010</Address>{length}<pPort>Device</pPort>")


DAMAGES = {
    **{
        f"{kind} of {count}": with_nodes(
            in_a_row(*CIRCLES[kind], [f"N{place}" for place in range(count)]),
            node("Integer", "R", "<pValue>WidthReg</pValue>"),
        )
        for kind in CIRCLES
        for count in (1, 3)
    },
    "a chain that fills the stack": with_nodes(chain(60_000)),
    "evaluations without end": with_nodes(doubling(40)),
    "a length below nothing": with_nodes(register("<Length>-1</Length>")),
    "a length beyond all memory": with_nodes(register("<Length>0x7fffffffffffff</Length>")),
    "no length": with_nodes(register("<Length>0</Length>")),
    "a length that another node tells": with_nodes(
        register("<pLength>N1</pLength>"), node("Integer", "N1", "<Value>-5</Value>")
    ),
    "a quotient without a place": with_nodes(
        node("IntSwissKnife", "N0", "<Formula>(1 &lt;&lt; 63) / (0 - 1)</Formula>")
    ),
    "a node that is missing": with_nodes(node("Integer", "N0", "<pValue>N1</pValue>")),
    "half a document": simulated()[: len(simulated()) // 2],
    "no document": b"\xff" * 1000,
    "nothing": b"",
    "entities": simulated().replace(
        b"<RegisterDescription", b'<!DOCTYPE r [<!ENTITY a "a">]><RegisterDescription', 1
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_description_is_refused_before_anything_of_it_is_evaluated(
    evaluator: Evaluator, bench: PracticeBench, damage: str
) -> None:
    bench.camera.serve_description(DAMAGES[damage])
    assert evaluator.tries(bench, "N0") == REFUSED
    assert evaluator.tries(bench) == REFUSED
    assert bench.camera.controller is None


@pytest.mark.slow
@pytest.mark.parametrize(
    "url",
    [
        "Local:a.xml;20000;7fffffffffffffff",
        "Local:a.xml;20000;0",
        "Local:a.zip;20000;100",
        "https://127.0.0.1/a.xml",
        "file:///dev/zero",
        "a.xml",
    ],
)
def test_a_description_in_a_place_that_does_not_exist_is_refused(
    evaluator: Evaluator, bench: PracticeBench, url: str
) -> None:
    bench.camera.serve_description(simulated(), url)
    assert evaluator.tries(bench, "Width") == REFUSED


@pytest.mark.slow
def test_an_archive_that_fills_the_memory_is_refused_and_a_sound_one_opened(
    evaluator: Evaluator, bench: PracticeBench
) -> None:
    for text, found in ((simulated(), ""), (bytes(LARGEST_BYTES + 1), REFUSED)):
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
            file.writestr("a.xml", text)
        data = archive.getvalue()
        bench.camera.serve_description(data, f"Local:a.zip;20000;{len(data):x}")
        assert evaluator.tries(bench) == found


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*HARMLESS, "pFeature", "pPort"])
def test_references_beside_a_value_lead_back_without_harm(
    evaluator: Evaluator, bench: PracticeBench, kind: str
) -> None:
    others = {
        "pFeature": ("Category", "<pFeature>{other}</pFeature>"),
        "pPort": ("IntReg", "<Address>0xa010</Address><Length>4</Length><pPort>{other}</pPort>"),
    }
    for names in (["N0"], ["N0", "N1"]):
        bench.camera.serve_description(
            with_nodes(
                in_a_row(*{**HARMLESS, **others}[kind], names),
                node("Integer", "R", "<pValue>WidthReg</pValue>"),
            )
        )
        assert evaluator.tries(bench, *names) == ""


@pytest.mark.slow
def test_a_long_formula_and_the_longest_chain_that_passes_are_evaluated(
    evaluator: Evaluator, bench: PracticeBench
) -> None:
    long = "(" * 20_000 + "1" + ")" * 20_000
    bench.camera.serve_description(
        with_nodes(chain(199), node("IntSwissKnife", "F", f"<Formula>{long}</Formula>"))
    )
    assert evaluator.tries(bench, "N0", "F") == ""


@pytest.mark.slow
def test_an_enumeration_without_entries_has_no_values(
    evaluator: Evaluator, bench: PracticeBench
) -> None:
    text = re.sub(rb"<EnumEntry.*?</EnumEntry>", b"", simulated())
    bench.camera.serve_description(text)
    assert evaluator.tries(bench, "PixelFormat", "TriggerMode", "GainAuto") == ""
    assert evaluator.tries(bench) == "CameraFeatureError"


def damaged(seed: int) -> bytes:
    """The simulated camera's description with some elements dropped, exchanged or falsified."""
    chance = random.Random(seed)
    text = simulated()
    values = [b"-1", b"0", b"", b"nan", b"1e308", b"0x7fffffffffffffff", b"9", b"65536"]
    for _ in range(chance.choice([1, 2, 4, 8])):
        elements = list(re.finditer(rb"<(\w+)([^<>]*)>([^<>]*)</\1>", text))
        one, other = chance.sample(elements, 2)
        new = chance.choice(
            [
                b"",
                b"<%b%b>%b</%b>" % (one[1], one[2], chance.choice(values), one[1]),
                b"<%b%b>%b</%b>" % (one[1], one[2], other[3], one[1]),
                b"<%b%b>%b</%b>" % (other[1], one[2], one[3], other[1]),
                one[0] + other[0],
            ]
        )
        text = text[: one.start()] + new + text[one.end() :]
    return text


@pytest.mark.slow
def test_whatever_is_wrong_with_a_description_the_process_lives_on(
    evaluator: Evaluator, bench: PracticeBench
) -> None:
    found = set()
    for seed in range(40):
        bench.camera.serve_description(damaged(seed))
        found.add(evaluator.tries(bench))
        assert evaluator.status is None, seed
        bench.camera.restart()
    assert {"", REFUSED} <= found
    assert all(kind == "" or kind.endswith("Error") for kind in found)


def test_the_camera_of_a_refused_description_can_be_opened_once_it_is_mended(
    bench: PracticeBench,
) -> None:
    bench.camera.serve_description(with_width("<pValue>Width</pValue>"))
    with pytest.raises(CameraDescriptionError) as refused:
        AravisCamera.open(camera_config(bench.camera.address))
    assert (refused.value.fault, refused.value.nodes) == ("circle", ("Width", "Width"))
    assert bench.camera.address in str(refused.value)
    with pytest.raises(CameraDescriptionError):
        probe_camera(camera_config(bench.camera.address))
    bench.camera.serve_description(simulated())
    with opened(bench) as camera:
        assert camera.settings.width_px == 96


def test_a_description_that_is_another_one_for_aravis_is_refused_as_well(
    bench: PracticeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.camera.serve_description(with_width("<pValue>Width</pValue>"))
    monkeypatch.setattr("acquisition.aravis._device.read_description", lambda *_: simulated())
    with pytest.raises(CameraDescriptionError):
        AravisCamera.open(camera_config(bench.camera.address))


def test_a_text_whose_length_the_camera_tells_is_read_unless_it_is_longer_than_any(
    bench: PracticeBench,
) -> None:
    register = b'<StringReg Name="DeviceVendorName"><Address>0x48</Address><Length>32</Length>'
    assert register in simulated()
    open_length = register.replace(b"<Length>32</Length>", b"<pLength>N0</pLength>")
    for length, is_sound in (("32", True), ("-5", False), ("0x7fffffffffff", False)):
        text = with_nodes(node("Integer", "N0", f"<Value>{length}</Value>"))
        bench.camera.serve_description(text.replace(register, open_length))
        if is_sound:
            with opened(bench) as camera:
                assert camera.info.vendor == "standoff"
        else:
            with pytest.raises(CameraDescriptionError) as refused:
                AravisCamera.open(camera_config(bench.camera.address))
            assert refused.value.nodes == ("DeviceVendorName", "DeviceVendorName")


def test_a_chunk_that_is_said_to_lie_outside_the_frame_is_refused() -> None:
    with gige_bench(maker="flir") as bench:
        features = features_of(None, has_temperature=False, maker="flir")
        text = describe(features, vendor="Point Grey Research", model="m")
        chunk = b'<FloatReg Name="ChunkExposureTimeReg"><Address>0</Address>'
        assert chunk in text
        bench.camera.serve_description(text.replace(b"<Address>0<", b"<Address>0x7fffffffff<"))
        with pytest.raises(CameraDescriptionError) as refused:
            AravisCamera.open(camera_config(bench.camera.address))
        assert refused.value.nodes == ("ChunkExposureTime", "ChunkExposureTimeReg")
        config = camera_config(bench.camera.address, chunk_data=False)
        AravisCamera.open(config).close()


@pytest.mark.parametrize(
    ("feature", "value"),
    [
        ("PayloadSize", "0x7fffffff"),
        ("PayloadSize", "10"),
        ("PayloadSize", "-1"),
        ("AcquisitionFrameRateLimit", "0"),
    ],
)
def test_sizes_and_times_that_no_frame_has_are_refused_by_their_feature(
    bench: PracticeBench, feature: str, value: str
) -> None:
    before = f"<pValue>{feature}Reg</pValue>".encode()
    assert before in simulated()
    bench.camera.serve_description(simulated().replace(before, f"<Value>{value}</Value>".encode()))
    with pytest.raises(CameraFeatureError) as refused:
        AravisCamera.open(camera_config(bench.camera.address))
    assert refused.value.feature in (feature, "AcquisitionFrameRateAbs")


@pytest.mark.parametrize(
    ("feature", "odd"),
    [
        ("Width", {"width_px": 0}),
        ("Height", {"height_px": -2}),
        ("ExposureTime", {"exposure_us": nan}),
        ("AcquisitionFrameRate", {"frame_rate_hz": 0.0}),
        ("AcquisitionFrameRate", {"frame_rate_hz": inf}),
    ],
)
def test_settings_that_no_camera_runs_with_are_refused_before_they_are_used(
    feature: str, odd: dict[str, float]
) -> None:
    with pytest.raises(CameraFeatureError) as refused:
        _require_usable(replace(SETTINGS, **odd))  # type: ignore[arg-type]  # one of its numbers
    assert refused.value.feature == feature


@pytest.mark.parametrize("bounds", ["nan", "inf"])
def test_a_width_that_is_no_number_is_refused(bench: PracticeBench, bounds: str) -> None:
    whole = re.search(rb'<Integer Name="Width">.*?</Integer>', simulated())
    assert whole is not None
    odd = f'<Float Name="Width"><pValue>WidthReg</pValue><Max>{bounds}</Max></Float>'.encode()
    bench.camera.serve_description(simulated().replace(whole[0], odd))
    with pytest.raises(CameraFeatureError) as refused:
        AravisCamera.open(camera_config(bench.camera.address))
    assert refused.value.feature == "Width"


def test_a_camera_without_an_exposure_is_refused_with_the_names_that_it_could_have(
    bench: PracticeBench,
) -> None:
    text = simulated().replace(b'Name="ExposureTimeAbs"', b'Name="ShutterSpeed"')
    bench.camera.serve_description(text)
    with pytest.raises(MissingFeatureError) as refused:
        AravisCamera.open(camera_config(bench.camera.address))
    assert "ExposureTime" in refused.value.names
    assert "standoff Simulated Manta" in str(refused.value)


def test_names_that_are_no_text_are_shown_as_far_as_they_can_be(bench: PracticeBench) -> None:
    registers = bench.camera._registers
    page = bytearray(registers._bootstrap)
    page[0x48:0x68] = b"\xff\xfem\xfcller".ljust(32, b"\0")
    registers._bootstrap = bytes(page)
    with closing(AravisCamera.open(camera_config(bench.camera.address))) as camera:
        assert camera.info.vendor.endswith("m\N{REPLACEMENT CHARACTER}ller")
