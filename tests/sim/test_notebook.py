"""`sim plot`: what is drawn is what the recording and its truth say."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tms_sim.notebook import draw, read_page


@pytest.fixture
def bag(command: Any, tmp_path: Path) -> Path:
    path = tmp_path / "run"
    assert command("tms_sim", "run", "gym_strikes", "-o", path).code == 0
    return path


def test_every_line_is_the_recorded_one(bag: Path) -> None:
    page = read_page(bag)
    figure = draw(page)
    path, angles, rates, steer_rate, speed, forces = figure.axes
    lines = {line.get_label(): line for axes in figure.axes for line in axes.get_lines()}
    state = page.state
    np.testing.assert_array_equal(lines["rear contact"].get_xydata(), state.rear_contact)
    np.testing.assert_allclose(lines["lean"].get_ydata(), np.degrees(state.state[:, 0]))
    np.testing.assert_array_equal(lines["yaw rate"].get_ydata(), state.yaw_rate)
    np.testing.assert_array_equal(lines["steer rate"].get_ydata(), state.state[:, 3])
    np.testing.assert_array_equal(lines["speed"].get_ydata(), state.speed)
    # Upright, the sensor reads one g up: minus one down.
    assert np.median(lines["down"].get_ydata()) == pytest.approx(-1.0, abs=0.1)
    assert path.yaxis_inverted()  # to the right is down the page, as seen from above
    assert [text.get_text() for text in path.texts] == ["struck to the right", "struck to the left"]
    assert "run-up" in [text.get_text() for text in angles.texts]
    assert "[rad/s]" in rates.get_ylabel()
    assert steer_rate.get_xlim() == speed.get_xlim() == forces.get_xlim()


def test_clipped_samples_are_marked(command: Any, tmp_path: Path) -> None:
    changes = ["--set", "imu.errors=all", "--set", "floor_vibration.rms=8.0"]
    command("tms_sim", "run", "gym_run", "-o", tmp_path / "run", *changes)
    page = read_page(tmp_path / "run")
    assert page.recording.lean_yaw is not None
    count = int(((page.recording.lean_yaw.saturation & 7) > 0).sum())
    assert count > 10
    (marks,) = [line for line in draw(page).axes[5].get_lines() if "clipped" in str(line.get_label())]
    assert re.findall(r"\d+", str(marks.get_label())) == [str(count)]
    assert len(np.asarray(marks.get_xdata())) == count


def test_from_the_command_line(bag: Path, command: Any, refused: Any, tmp_path: Path) -> None:
    done = command("tms_sim", "plot", bag, "-o", tmp_path / "deep" / "page.png")
    assert (done.code, done.out, done.err) == (0, "", "")
    assert (tmp_path / "deep" / "page.png").read_bytes().startswith(b"\x89PNG")
    assert "ends in .png, .svg or .pdf" in refused("tms_sim", "plot", bag, "-o", tmp_path / "page.txt")
    command("tms_sim", "run", "gym_run", "-o", tmp_path / "blind", "--blind")
    said = refused("tms_sim", "plot", tmp_path / "blind", "-o", tmp_path / "blind.png")
    assert "expected a simulated run with its truth" in said
    assert not (tmp_path / "blind.png").exists()
    assert "nowhere" in refused("tms_sim", "plot", tmp_path / "nowhere", "-o", tmp_path / "page.png")
