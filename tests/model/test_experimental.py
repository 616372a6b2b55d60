"""SOM chapters 8-10: tables 8.1 and 8.2, the parameters behind Eq. (10.1), how little gyro there is."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from tms_model import ParameterError, linear_system, load_bicycle, stability
from tms_model.response import STEER, STEER_RATE
from tms_model.supplement.experimental import (
    PRINTED_TOTALS_GRAMS,
    angular_momentum_ratio,
    angular_momentum_ratio_of,
    totals_grams,
)

PUBLISHED = yaml.safe_load((Path(__file__).parents[1] / "data" / "two_mass_skate.yaml").read_text())
TABLE: dict[str, str] = PUBLISHED["table_8_1"]


def half_digit(printed: str) -> float:
    return 0.5 * 10.0 ** -len(printed.partition(".")[2])


def in_table_units(name: str, key: str) -> float:
    parameters = load_bicycle(name).parameters
    assert parameters is not None
    if key == "steer_axis_tilt_deg":
        return math.degrees(parameters.steer_axis_tilt)
    return float(getattr(parameters, key))


@pytest.mark.parametrize("key", TABLE)
def test_table_8_1_is_carried_as_printed(key: str) -> None:
    assert in_table_units("tms_table_8_1", key) == pytest.approx(float(TABLE[key]), rel=1e-15)


@pytest.mark.parametrize("key", TABLE)
def test_unrounded_parameters_are_what_table_8_1_rounds(key: str) -> None:
    unrounded = in_table_units("tms_unrounded_8_1", key)
    assert abs(unrounded - float(TABLE[key])) <= half_digit(TABLE[key])


@pytest.mark.parametrize("letter", ["M", "C1", "K0", "K2"])
def test_unrounded_parameters_give_equation_10_1(letter: str) -> None:
    # To half a unit of the last printed digit, all entries: the zeros of C1 and K2 demand wheels without
    # spin.
    ours = load_bicycle("tms_unrounded_8_1").canonical[letter]
    np.testing.assert_allclose(
        ours, PUBLISHED["equation_10_1"][letter], rtol=0.0, atol=PUBLISHED["half_digit_10_1"]
    )


def test_no_point_with_the_printed_tilt_gives_equation_10_1() -> None:
    # K0 alone says the tilt: sin(lambda) = K0_dd / K0_pd = 0.004099 / 0.033536 = 0.12223, 7.0207 deg, and its
    # half digits leave 7.0198 to 7.0217: the printed 7 is rounded.
    k0 = PUBLISHED["equation_10_1"]["K0"]
    half = PUBLISHED["half_digit_10_1"]
    low = math.degrees(math.asin((-k0[1][1] - half) / (-k0[0][1] + half)))
    high = math.degrees(math.asin((-k0[1][1] + half) / (-k0[0][1] - half)))
    assert 7.0 < low < in_table_units("tms_unrounded_8_1", "steer_axis_tilt_deg") < high


def test_equation_10_3_is_of_the_rounded_table() -> None:
    # Its 1.3234 is cos(7 deg) / 0.750; with the unrounded tilt and wheelbase that K2 / K0 of (10.1) demand,
    # the yaw rate's coefficient would print 1.3232. (10.1) and (10.3) weren't computed from the same digits.
    printed = PUBLISHED["equation_10_3"]
    eq = PUBLISHED["equation_10_1"]
    table = linear_system(load_bicycle("tms_table_8_1"), 1.0).yaw
    unrounded = linear_system(load_bicycle("tms_unrounded_8_1"), 1.0).yaw
    assert round(table[STEER], 4) == printed["steer"]
    assert round(table[STEER_RATE], 7) == printed["steer_rate"]
    assert round(unrounded[STEER], 4) == 1.3232
    assert unrounded[STEER] == pytest.approx(-eq["K2"][0][1] / eq["K0"][0][0], rel=1e-6)


def test_unrounded_parameters_ride_as_equation_10_1() -> None:
    # The onset of stability to five digits: what the matrices' printed digits leave.
    onset = PUBLISHED["onset"]["computed"]["tms_eq_10_1"]
    assert stability(load_bicycle("tms_unrounded_8_1")).onset_speed == pytest.approx(onset, rel=2e-5)


def test_mass_budget_adds_up() -> None:
    # Table 8.2: the parts sum to the printed totals, these to the masses of table 8.1, these to 8.837 kg.
    sums = totals_grams()
    printed = PUBLISHED["table_8_2"]
    assert sums == PRINTED_TOTALS_GRAMS
    assert list(sums.values()) == [
        printed[f"total_{part}"] for part in ("wheels", "rear_frame", "front_frame", "bicycle")
    ]
    assert sums["rear frame"] == 1000.0 * in_table_units("tms_table_8_1", "rear_frame_mass")
    assert sums["front frame"] == 1000.0 * in_table_units("tms_table_8_1", "front_frame_mass")


def test_angular_momentum_ratio_by_hand() -> None:
    # (9.1) with omega = v / r: 1.8e-5 / 0.05 / (8.837 * 0.5) = 3.6e-4 / 4.4185 = 8.1476e-5.
    assert angular_momentum_ratio(1.8e-5, 0.05, 8.837, 0.5) == pytest.approx(8.1476e-5, abs=0.5e-9)
    # The last step of (9.2) as printed would be 1.63e-3 v: it grows with the speed, which has to cancel.
    speed = 3.6
    first = (1.8e-5 * speed / 0.05) / (8.837 * speed * 0.5)
    assert first == pytest.approx(angular_momentum_ratio(1.8e-5, 0.05, 8.837, 0.5), rel=1e-14)
    as_printed = (1.8e-5 * speed / 0.05) / (8.837 * 0.5 * 0.05)
    assert as_printed == pytest.approx(1.63e-3 * speed, rel=1e-3)


def test_normal_bicycle_has_the_printed_ratio() -> None:
    # 'For a normal riderless bicycle C_ang = 0.02': the riderless steer-by-wire bicycle, 0.0193.
    printed = PUBLISHED["angular_momentum_ratio"]
    assert round(angular_momentum_ratio_of(load_bicycle("delft_sbw")), 2) == printed["normal_bicycle"]


def test_ratio_before_the_counter_rotating_wheels() -> None:
    # Table 8.1's 1.8e-5 is what a tenth leaves, 1.8e-4 were there before: 0.0008 with h = 0.5 m, 0.0010 with
    # the height of the centre of mass, 0.39 m. The text doesn't say its h.
    printed = PUBLISHED["angular_momentum_ratio"]
    before = 1.8e-5 / (1.0 - printed["cancelled_share"])
    half_metre = angular_momentum_ratio(before, 0.05, 8.837, 0.5)
    assert round(half_metre, 4) == printed["before_counter_rotating_wheels"]
    centre = angular_momentum_ratio_of(load_bicycle("tms_table_8_1")) / (1.0 - printed["cancelled_share"])
    assert round(centre, 4) == 0.0010
    # The wheel itself, 174 g, between half a disc of 100 mm, for its holes, and a ring.
    assert 0.25 * 0.174 * 0.05**2 < before < 0.174 * 0.05**2


def test_six_grams_of_rubber_for_aluminium_are_a_tenth() -> None:
    # 6 g at 50 mm: 1.5e-5 kg m^2, of 1.8e-4 kg m^2 8 %: the 90 % of the text to its one digit.
    printed = PUBLISHED["angular_momentum_ratio"]
    missing = 1e-3 * printed["lighter_grams"] * 0.05**2
    assert missing == pytest.approx(1.5e-5)
    assert round(1.0 - missing / 1.8e-4, 1) == printed["cancelled_share"]


def test_share_of_a_normal_bicycle() -> None:
    # 'About 5 % of a normal bicycle wheel' and 'about 0.5 %' after: 0.0008 / 0.02 = 4 %, and a tenth of that.
    printed = PUBLISHED["angular_momentum_ratio"]
    ratio = printed["before_counter_rotating_wheels"] / printed["normal_bicycle"]
    assert ratio == pytest.approx(0.05, abs=0.011)
    ours = angular_momentum_ratio_of(load_bicycle("tms_table_8_1"))
    normal = angular_momentum_ratio_of(load_bicycle("delft_sbw"))
    assert round(100.0 * ours / normal, 1) == 0.5


def test_ratio_asks_for_parameters() -> None:
    with pytest.raises(ParameterError, match="tms_eq_10_1: expected parameters, found matrices only"):
        angular_momentum_ratio_of(load_bicycle("tms_eq_10_1"))
