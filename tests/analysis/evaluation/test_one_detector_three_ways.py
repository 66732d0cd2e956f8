"""One detector as a function, by its name, as a command and as an ONNX file: one evaluation."""

import shlex
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
import tifffile
from onnx import TensorProto, helper

import standoff
from analysis.evaluation import EvaluationCurve
from simulation import GaussianPsf
from simulation.arrays import Float32Array, FloatArray

MODULE = """
import sys

import numpy as np


def changed(reference, followup, homography):
    return np.asarray(np.abs(followup - 250.0), np.float64)


if __name__ == "__main__":
    import tifffile

    followup = tifffile.imread(sys.argv[2])
    tifffile.imwrite(sys.argv[3], changed(None, followup, None).astype(np.float32))
"""


def changed(reference: Float32Array, followup: Float32Array, homography: FloatArray) -> FloatArray:
    """What the module does."""
    return np.asarray(np.abs(followup - 250.0), np.float64)


def network(path: Path) -> str:
    """The same as an ONNX file: weights 0 and 1, an offset, and the absolute value."""
    weights = helper.make_tensor("w", TensorProto.FLOAT, [1, 2, 1, 1], [0.0, 1.0])
    offset = helper.make_tensor("b", TensorProto.FLOAT, [1], [-250.0])
    nodes = [
        helper.make_node("Conv", ["photographs", "w", "b"], ["made"]),
        helper.make_node("Abs", ["made"], ["changed"]),
    ]
    frame = helper.make_tensor_value_info("photographs", TensorProto.FLOAT, ["N", 2, "H", "W"])
    made = helper.make_tensor_value_info("changed", TensorProto.FLOAT, None)
    graph = helper.make_graph(nodes, "detector", [frame], [made], [weights, offset])
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), str(path))
    return str(path)


@pytest.mark.slow
def test_they_have_the_same_curves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    rng = np.random.default_rng(8)
    for number in range(2):
        image = 250 + 4 * rng.standard_normal((120, 120))
        tifffile.imwrite(photographs / f"{number}.tif", image.astype(np.float32))
    monkeypatch.chdir(tmp_path)
    Path("three_ways.py").write_text(MODULE)
    command = shlex.join([sys.executable, "three_ways.py", "{reference}", "{followup}", "{out}"])
    task = standoff.EvaluationTask(
        zooms=(1.0, 1.5), contrasts_dn=(14.0,), crop_px=40, crops=4, model="matched"
    )
    psf = GaussianPsf(sigma_px=0.7)

    def curves(detector: object) -> list[EvaluationCurve]:
        found = standoff.evaluate(detector, photographs, psf, task).evaluation  # type: ignore[arg-type]
        assert found is not None
        assert found.failed == []
        return [curve.model_copy(update={"detector": ""}) for curve in found.curves]

    as_function = curves(changed)
    assert curves("three_ways:changed") == as_function
    assert curves(command) == as_function
    assert curves(network(tmp_path / "three_ways.onnx")) == as_function
