"""Two changes of the lean rate closer than two strikes can be, and what a strike's size must reach."""

from typing import Any

import numpy as np
import pytest
from tms_fit.recording_fit import find_strikes
from tms_fit.strikes import detector as detector_module
from tms_fit.strikes.classification import classify_kink
from tms_fit.strikes.detector import StrikeDetector
from tms_fit.strikes.thresholds import StrikeThresholds


def found(make_run: Any, gap: float, sizes: tuple[float, float]) -> tuple[list[float], list[str]]:
    """Times [s] of the strikes found in a run with two, and why other changes were none."""
    run = make_run(
        "tms_strike",
        strike__time=(2.0, 2.0 + gap),
        strike__lean_rate=sizes,
        duration=5.0,
        strike__duration=0.01,
    )
    strikes, rejected = find_strikes(run.recording())
    return [(one.time_ns - run.info.start_ns) / 1e9 for one in strikes], [one.why for one in rejected]


@pytest.mark.parametrize(
    ("gap", "sizes", "times"),
    [
        (0.33, (0.25, 0.5), [2.33]),
        (0.33, (0.25, -0.5), [2.33]),
        (0.3, (0.5, 0.45), [2.0]),
        (0.3, (0.5, -0.3), [2.0]),
        (0.4, (0.25, 0.5), [2.0, 2.4]),
        (0.4, (0.5, -0.3), [2.0, 2.4]),
    ],
)
def test_of_two_sudden_changes_closer_than_documented_the_larger_is_the_strike(
    make_run: Any, gap: float, sizes: tuple[float, float], times: list[float]
) -> None:
    seen, why = found(make_run, gap, sizes)
    assert seen == pytest.approx(times, abs=0.025)
    assert any("strikes closer than 0.35 s count as one" in one for one in why) == (len(times) == 1)


def test_a_sudden_change_reaches_what_its_line_says_was_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[Any, int]] = []

    def keep(history: Any, trigger_ns: int, needed: float, settings: StrikeThresholds) -> Any:
        calls.append((history, trigger_ns))
        return classify_kink(history, trigger_ns, needed, settings)

    monkeypatch.setattr(detector_module, "classify_kink", keep)
    time = np.arange(400) / 100.0
    rate = np.where(time > 2.0, 0.25, 0.0) + 0.01 * np.random.default_rng(5).standard_normal(len(time))
    detector = StrikeDetector()
    strikes = [detector.push(round(t * 1e9), r) for t, r in zip(time.tolist(), rate.tolist(), strict=True)]
    assert len([one for one in strikes if one]) == 1
    ((history, trigger_ns),) = calls
    least = StrikeThresholds()
    assert classify_kink(history, trigger_ns, 0.2, least) is not None
    assert classify_kink(history, trigger_ns, 0.33, least) is None
