"""The steer-by-wire logs of TU Delft: the numbers that their README states come out of the imported bags."""

import math

import numpy as np
import pytest
from tms_bag import RecordingError, read_recording
from tms_bag.checks import findings, survey
from tms_bag.imu_mounting import imu_mounting
from tms_bag.logs.csv_import import import_csv
from tms_bag.logs.mapping import load_mapping

LOGS = [
    ("eigen_normal_sil6.5n2_10.8kph.log", 10835, 3.0, 6.93),
    ("eigen_normal_sil6.5n2_14.4kph.log", 9163, 4.0, 4.71),
]


@pytest.fixture(scope="module", params=LOGS, ids=["10.8 km/h", "14.4 km/h"])
def imported(request, delft_data, tmp_path_factory):
    name, *numbers = request.param
    path = tmp_path_factory.mktemp("delft") / "bag"
    import_csv(delft_data / name, load_mapping("delft_sbw"), path)
    table = np.genfromtxt(delft_data / name, delimiter=",", names=True)
    return read_recording(path), table, numbers


def test_every_row_is_a_sample_of_the_same_time_on_each_topic(imported):
    recording, table, (count, _, _) = imported
    assert table.size == count
    expected = 1_000_000_000 + 10_000_000 * np.arange(count)
    for samples in (recording.imu, recording.lean_yaw, recording.speed, recording.steer_torque):
        assert np.array_equal(samples.time_ns, expected)


def test_values_are_those_of_the_log(imported):
    recording, table, _ = imported
    assert np.array_equal(recording.imu.angular_velocity[:, 0], table["lean_rate"])
    assert np.isnan(recording.imu.angular_velocity[:, 1:]).all()
    assert np.array_equal(recording.imu.specific_force[:, 1], -table["y_acceleration"])
    assert np.isnan(recording.imu.specific_force[:, [0, 2]]).all()
    assert np.array_equal(recording.lean_yaw.lean, table["lean_angle"])
    assert np.array_equal(recording.lean_yaw.lean_rate, table["lean_rate"])
    assert np.isnan(recording.lean_yaw.yaw_rate).all()
    assert np.array_equal(recording.speed.speed, table["speed"])
    assert np.array_equal(recording.steer_torque.steer_torque, table["sil_command"])


def test_the_steer_torque_follows_the_lean_rate_with_the_stated_slope(imported):
    recording, _, (_, speed, slope) = imported
    rate = recording.imu.angular_velocity[:, 0]
    found = np.polyfit(rate, recording.steer_torque.steer_torque, 1)[0]
    assert round(found, 2) == slope
    assert np.median(recording.speed.speed) == pytest.approx(speed, abs=0.2)


def test_the_lateral_specific_force_shows_left_in_the_imu_frame(imported):
    # Leaning to the right turns gravity's reaction (up) to the left of the frame: y, which points left, feels
    # +g sin(lean). Fast motions average out over 0.3 s; lateral accelerations are fitted beside it.
    recording, table, _ = imported
    smooth = np.ones(31) / 31

    def smoothed(x):
        return np.convolve(x, smooth, "valid")

    lean, rate = smoothed(table["lean_angle"]), smoothed(table["lean_rate"])
    w, c, tilt = 1.036, 0.0803, math.radians(18.2)
    yaw_rate = (table["speed"] * table["fork_angle"] + c * table["fork_rate"]) * math.cos(tilt) / w
    columns = [lean, np.gradient(rate, 0.01), smoothed(table["speed"] * yaw_rate), np.ones(lean.size)]
    force = smoothed(recording.imu.specific_force[:, 1])
    fit, residual, _, _ = np.linalg.lstsq(np.stack(columns, axis=1), force, rcond=None)
    assert fit[0] == pytest.approx(9.81, rel=0.15)
    assert fit[2] == pytest.approx(-1.0, rel=0.5)  # turning right accelerates to the right
    assert 1.0 - residual[0] / np.var(force) / force.size > 0.8


def test_the_bag_knows_the_bicycle_and_its_nominal_speed(imported):
    recording, _, (_, speed, _) = imported
    assert recording.run_info.bicycle == "delft_sbw"
    assert recording.run_info.parameters["wheelbase"] == 1.036
    assert recording.run_info.speed == pytest.approx(speed, abs=0.2)
    assert np.isnan(recording.run_info.imu_position).all()
    assert not recording.run_info.simulated


@pytest.mark.parametrize("name", ["Flat_on_ground_gravityZ.log", "LICENCE", "README.md"])
def test_files_that_are_other_things_are_refused(delft_data, tmp_path, name):
    with pytest.raises(RecordingError, match="expected the columns 'lean_rate'"):
        import_csv(delft_data / name, load_mapping("delft_sbw"), tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_one_gyroscope_shows_no_mounting_and_raises_no_alarm(imported):
    recording, _, _ = imported
    with pytest.raises(RecordingError, match=r"expected (gravity|100 or more samples of all three)"):
        imu_mounting(recording.imu, recording.speed, recording.run_info.imu_orientation)
    assert {"gravity_direction", "strike_axis"}.isdisjoint(
        name for name, _ in findings(survey(recording.path))
    )
