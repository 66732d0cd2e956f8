"""Go, no go or unsure: right as often as stated, and what would turn a verdict."""

from math import exp, log

import numpy as np
import pytest

from analysis.detectability import (
    CurveUncertainty,
    DetectabilityCurve,
    DPrimeSlopes,
    ErrorSources,
)
from analysis.pose import decide, verdict_of

ERR = 0.05


def curve(sources: ErrorSources | None = None, **slopes: float) -> DetectabilityCurve:
    stated = DPrimeSlopes(**({"psf_per_px2": -1.0, "noise": -0.2} | slopes))
    uncertainty = CurveUncertainty(
        sources=sources or ErrorSources(), scene=[ERR] * 2, slopes=[stated] * 2
    )
    return DetectabilityCurve(
        model="matched",
        observer="hotelling",
        noise_dn=2.0,
        contrast_dn=12.0,
        signal_sigma_px=2.0,
        zoom=[1.0, 2.0],
        dprime=[4.0, 2.0],
        dprime_low=[3.0, 1.5],
        dprime_high=[5.0, 2.5],
        auc=[0.9, 0.8],
        uncertainty=uncertainty,
    )


@pytest.mark.parametrize(
    ("d_prime", "verdict"),
    [(2 * exp(1.65 * ERR), "go"), (2 * exp(-1.65 * ERR), "no go"), (2.0, "unsure"), (0.0, "no go")],
)
def test_a_verdict_is_given_from_95_percent_on(d_prime: float, verdict: str) -> None:
    found = decide(curve(), 1.5, d_prime, 2.0)
    assert found.verdict == verdict == verdict_of(found.probability)


def test_go_and_no_go_are_wrong_as_rarely_as_stated() -> None:
    # Where the true d' is the threshold itself, either verdict comes in 5 %; elsewhere, the wrong
    # one comes more rarely.
    rng = np.random.default_rng(8)
    known = curve(ErrorSources(focus_scatter_px2=0.0))
    seen = 2.0 * np.exp(ERR * rng.standard_normal(2000))
    verdicts = [decide(known, 1.5, float(one), 2.0).verdict for one in seen]
    # 2000 of 5 %: 999 of 1000 stay below 6.6 %.
    assert verdicts.count("go") / 2000 < 0.066
    assert verdicts.count("no go") / 2000 < 0.066


def test_the_focus_that_would_turn_a_verdict_turns_it() -> None:
    loose = curve(signal_per_px2=-2.0, followup_per_px4=4.0)
    d_prime = 2 * exp(2.5 * ERR)
    found = decide(loose, 1.5, d_prime, 2.0)
    assert found.verdict == "go"
    assert "focus" in found.unknown_sources
    assert found.focus_turning_px2 is not None
    for share, verdict in ((0.97, "go"), (1.03, "unsure")):
        stated = loose.knowing(focus_scatter_px2=share * found.focus_turning_px2)
        assert decide(stated, 1.5, d_prime, 2.0).verdict == verdict
    assert f"{found.focus_turning_px2:.2g} px^2" in (found.unknown_sentence or "")


def test_a_focus_that_turns_nothing_is_said_to() -> None:
    found = decide(curve(), 1.5, 2 * exp(5 * ERR), 2.0)
    assert found.focus_turning_px2 is None
    assert "would turn it" in (found.unknown_sentence or "")


def test_the_budget_names_what_decides_and_what_would_shrink_it() -> None:
    sources = ErrorSources(focus_scatter_px2=0.1, psf_variance_err_px2=0.01)
    found = decide(curve(sources, signal_per_px2=-2.0), 1.5, 2.0, 2.0)
    assert [one.source for one in found.budget] == ["focus", "scene", "psf"]
    expected = 0.2**2 / (0.2**2 + ERR**2 + 0.01**2)  # closed form
    assert found.budget[0].share == pytest.approx(expected, rel=1e-3)
    assert found.verdict == "unsure"
    assert "a focus that repeats better" in found.sentence


def test_exact_curves_are_certain() -> None:
    exact = curve().model_copy(
        update={"uncertainty": None, "dprime_low": [4.0, 2.0], "dprime_high": [4.0, 2.0]}
    )
    assert decide(exact, 2.0, 2.0, 2.0).probability == 1.0
    assert decide(exact, 2.0, 1.999, 2.0).probability == 0.0
    assert log(decide(exact, 2.0, 2.0, 2.0).dprime_interval_95[0] / 2.0) == pytest.approx(0.0)
