import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from analysis.detectors import DetectorSpec, followup_view, open_detector, takes_colour
from analysis.detectors._onnx_model import onnx_detector
from analysis.errors import DetectorError, DetectorFault
from simulation.arrays import Float32Array

FRAME: list[int | str] = ["N", 2, "H", "W"]
MOVED = np.array([[1.0, 0, 1.5], [0, 1, 0], [0, 0, 1]])


Inputs = tuple[list[int | str], ...]


def network(
    path: Path,
    operator: str,
    inputs: Inputs = (FRAME,),
    **options: Any,
) -> Path:
    """Write a network of one operator on its inputs, and after it the absolute value."""
    names = [f"photographs{number}" for number in range(len(inputs))]
    weights = []
    if operator == "Conv":  # the follow-up less the reference
        values = np.array([-1, 1], dtype=np.float32)
        weights = [helper.make_tensor("weights", TensorProto.FLOAT, [1, 2, 1, 1], values)]
    nodes = [
        helper.make_node(operator, [*names, *(one.name for one in weights)], ["made"], **options),
        helper.make_node("Abs", ["made"], ["changed"]),
    ]
    graph = helper.make_graph(
        nodes,
        "detector",
        [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
            for name, shape in zip(names, inputs, strict=True)
        ],
        [helper.make_tensor_value_info("changed", TensorProto.FLOAT, None)],
        weights,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.save(model, str(path))
    return path


def photographs() -> tuple[Float32Array, Float32Array]:
    rng = np.random.default_rng(4)
    levels = rng.normal(100, 10, (2, 12, 15)).astype(np.float32)
    return levels[0], levels[1, :10]


@pytest.mark.slow
def test_a_network_gets_the_reference_on_the_followups_pixels_and_returns_a_map(
    tmp_path: Path,
) -> None:
    reference, followup = photographs()
    path = network(tmp_path / "difference.onnx", "Conv")
    with open_detector(DetectorSpec.parse(str(path))) as detector:
        answer = detector(reference, followup, MOVED)
        again = detector(reference, followup[:7], MOVED)  # another size
    seen = followup_view(reference, (10, 15), MOVED)
    expected = np.abs(followup - np.where(seen.inside, seen.levels, followup).astype(np.float32))
    assert answer.map is not None
    np.testing.assert_allclose(answer.map[seen.inside], expected[seen.inside], atol=1e-4)
    assert answer.score == pytest.approx(expected.max(), abs=1e-4)
    assert again.map is not None
    assert again.map.shape == (7, 15)


def test_a_network_of_six_channels_gets_the_colours_of_both(tmp_path: Path) -> None:
    path = network(tmp_path / "colours.onnx", "ReduceMean", (["N", 6, "H", "W"],), axes=[2, 3])
    network_of = onnx_detector(str(path))
    assert takes_colour(network_of)
    given: list[Float32Array] = []

    class Session:
        def run(self, _: None, asked: dict[str, Float32Array]) -> list[Float32Array]:
            given.extend(asked.values())
            return [np.zeros((1, 1), np.float32)]

    network_of._session = Session()  # type: ignore[attr-defined]
    rng = np.random.default_rng(6)
    reference, followup = rng.normal(100, 10, (2, 9, 11, 3)).astype(np.float32)
    assert network_of(reference, followup, np.eye(3)) == 0.0
    planes = np.concatenate([reference, followup], axis=2).transpose(2, 0, 1)
    np.testing.assert_allclose(given[0], planes[np.newaxis], rtol=1e-5)


def test_a_network_may_return_a_number(tmp_path: Path) -> None:
    path = network(tmp_path / "mean.onnx", "ReduceMean", axes=[1, 2, 3], keepdims=0)
    _, followup = photographs()
    found = onnx_detector(str(path))(followup, followup, np.eye(3))
    assert found == pytest.approx(followup.mean(), rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("operator", "inputs", "options", "reason", "words"),
    [
        ("Conv", (["N", 2, 64, 64],), {}, "shape", "takes only 64 x 64 px, but the follow-up has"),
        ("Identity", (["N", 3, "H", "W"],), {}, "shape", "it takes N x 3 x H x W"),
        ("Identity", (["N", 2],), {}, "shape", "it takes N x 2; expected"),
        ("Add", (FRAME, FRAME), {}, "shape", "expected one input"),
        ("Identity", (FRAME,), {}, "shape", "it returned 1 x 2 x 10 x 15 values"),
        ("ReduceMean", (FRAME,), {"axes": [2, 3], "keepdims": 0}, "shape", "returned 1 x 2 values"),
        (
            "AveragePool",
            (["N", 2, "H", "W"],),
            {"kernel_shape": [99, 99]},
            "crashed",
            "it raised",
        ),
    ],
)
def test_what_a_network_does_wrong_is_named(
    tmp_path: Path,
    operator: str,
    inputs: Inputs,
    options: dict[str, Any],
    reason: DetectorFault,
    words: str,
) -> None:
    path = network(tmp_path / "net.onnx", operator, inputs, **options)
    with (
        pytest.raises(DetectorError, match=r"^detector net.onnx: ") as raised,
        open_detector(DetectorSpec.parse(str(path))) as detector,
    ):
        detector(*photographs(), np.eye(3))
    assert raised.value.reason == reason
    assert words in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.slow
def test_a_network_whose_levels_overflow_is_said(tmp_path: Path) -> None:
    # The product of two levels of 1e32 is beyond float32.
    path = network(tmp_path / "huge.onnx", "ReduceProd", axes=[1], keepdims=1)
    reference, followup = (1e30 * image for image in photographs())
    with open_detector(DetectorSpec.parse(str(path))) as detector:
        for _ in range(2):
            with pytest.raises(DetectorError, match="not finite at 150 of the 150 px") as raised:
                detector(reference, followup, np.eye(3))
            assert raised.value.reason == "not_finite"


@pytest.mark.slow
def test_a_file_that_is_no_network_is_said_before_the_first_pair(tmp_path: Path) -> None:
    (tmp_path / "torn.onnx").write_bytes(b"\x08\x07not a network")
    spec = DetectorSpec.parse(str(tmp_path / "torn.onnx"))
    with pytest.raises(DetectorError, match="cannot be loaded") as raised, open_detector(spec):
        pass
    assert raised.value.reason == "missing"


def test_without_onnxruntime_the_remedy_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = network(tmp_path / "difference.onnx", "Conv")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(DetectorError, match=r"pip install 'standoff\[onnx\]'") as raised:
        onnx_detector(str(path))
    assert raised.value.reason == "missing"


def endless(path: Path) -> Path:
    """Write a network that never answers: a loop of 2^62 rounds."""
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["going"], ["goes"]),
            helper.make_node("Sin", ["before"], ["after"]),
        ],
        "round",
        [
            helper.make_tensor_value_info("number", TensorProto.INT64, []),
            helper.make_tensor_value_info("going", TensorProto.BOOL, []),
            helper.make_tensor_value_info("before", TensorProto.FLOAT, FRAME),
        ],
        [
            helper.make_tensor_value_info("goes", TensorProto.BOOL, []),
            helper.make_tensor_value_info("after", TensorProto.FLOAT, FRAME),
        ],
    )
    graph = helper.make_graph(
        [helper.make_node("Loop", ["most", "start", "photographs"], ["changed"], body=body)],
        "detector",
        [helper.make_tensor_value_info("photographs", TensorProto.FLOAT, FRAME)],
        [helper.make_tensor_value_info("changed", TensorProto.FLOAT, FRAME)],
        [
            helper.make_tensor("most", TensorProto.INT64, [], [1 << 62]),
            helper.make_tensor("start", TensorProto.BOOL, [], [True]),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.save(model, str(path))
    return path


@pytest.mark.slow
def test_a_network_that_hangs_in_its_own_code_is_ended(tmp_path: Path) -> None:
    spec = DetectorSpec.parse(str(endless(tmp_path / "endless.onnx")))
    with (
        open_detector(spec, timeout_s=1.0) as detector,
        pytest.raises(DetectorError, match="no answer within 1 s") as raised,
    ):
        detector(*photographs(), np.eye(3))
    assert raised.value.reason == "hung"
