"""Errors of all packages: they go from process to process with their details."""

import importlib
import inspect
import pickle
import pkgutil
from collections.abc import Iterator

import pytest

from acquisition.errors import DeviceTimeoutError, KeepsFacts, StageStalledError
from analysis.errors import BeyondCurveError
from calibration.errors import PairError

PACKAGES = ("acquisition", "calibration", "simulation", "analysis", "standoff")


@pytest.mark.parametrize(
    "error",
    [
        BeyondCurveError("too far", zoom=3.0, largest_zoom=2.0),
        DeviceTimeoutError("no answer", timeout_s=2.0),
        PairError("none", reason="no_pair", photographs=("a.png", "b.png")),
        StageStalledError("stalled", timeout_s=1.0, state="Run", height_mm=40.0),
    ],
    ids=lambda error: type(error).__name__,
)
def test_a_pickled_error_keeps_its_message_and_its_facts(error: Exception) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)


def error_classes() -> Iterator[type[Exception]]:
    for package in PACKAGES:
        for found in pkgutil.walk_packages(
            importlib.import_module(package).__path__, f"{package}."
        ):
            if found.name.rpartition(".")[2].endswith("errors"):
                for one in vars(importlib.import_module(found.name)).values():
                    if inspect.isclass(one) and issubclass(one, Exception):
                        yield one


def test_every_error_that_needs_facts_keeps_them() -> None:
    lost = set()
    for kind in error_classes():
        needed = [
            one
            for one in inspect.signature(kind.__init__).parameters.values()
            if one.kind is one.KEYWORD_ONLY and one.default is one.empty
        ]
        if needed and not issubclass(kind, KeepsFacts):
            lost.add(kind.__name__)
    assert lost == set()
