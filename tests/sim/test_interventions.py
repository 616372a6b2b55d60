"""What the experimenters changed at the bicycle (supplement, chapter 11), and what became of it.

The outcomes stand in the interventions' files as the supplement tells them; here simulated runs show theirs.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tms_model import ParameterError, load_bicycle
from tms_sim.floor import FLOORS, WHEELS, load_floor, load_wheels
from tms_sim.intervention import FOLDER, changed_bicycle, load_intervention
from tms_sim.motion import Trajectory

# Nothing that hides whether the bicycle stays up by itself: constant speed, hardly struck.
GENTLE: dict[str, Any] = {
    "effects__rolling_resistance": False,
    "catch__lean_deg": 0.0,
    "catch__speed": 0.0,
    "strike__lean_rate": 0.05,
    "asymmetry__rear_frame": 0.0,
    "release__lean_deg": 0.1,
    "duration": 12.0,
}
CASES = [("intervention", path.stem) for path in sorted(FOLDER.glob("*.yaml"))] + [("wheels", "polyurethane")]


def outcome(key: str, name: str) -> dict[str, bool | None]:
    if key == "intervention":
        return dict(load_intervention(name).outcome)
    return {"shimmy": False, "self_stable": False, "slows_drastically": None}  # told of the wheels


def shimmy_size(run: Trajectory) -> float:
    """Largest steer rate [rad/s] between 15 and 25 Hz after the release and before the strike."""
    times = np.arange(3.0, 4.0, 0.001)
    rate = run.at(times).steer_rate
    rest = rate - np.polyval(np.polyfit(times - 3.0, rate, 5), times - 3.0)
    spectrum = np.abs(np.fft.rfft(rest * np.hanning(1000))) * 4.0 / 1000
    return float(spectrum[15:26].max())


@pytest.mark.parametrize(("key", "name"), CASES)
def test_runs_end_as_the_supplement_tells(go: Any, key: str, name: str) -> None:
    told, run = outcome(key, name), go("gym_run", **{key: name}, **GENTLE)
    size = shimmy_size(run)
    assert size > 0.1 if told["shimmy"] else size < 0.01
    if told["self_stable"] is not None:
        late = run.at(np.linspace(9.0, 12.0, 300)).lean if run.ended_by == "duration" else np.array([1.0])
        assert bool(math.degrees(np.abs(late).max()) < 1.0) is told["self_stable"]
        assert (run.ended_by == "fallen") is not told["self_stable"]
    if told["slows_drastically"] is not None:
        usual, changed = (
            -go("gym_run", **changes).at(np.array([2.5])).acceleration[0] for changes in ({}, {key: name})
        )
        assert bool(changed > 2.0 * usual) is told["slows_drastically"]


def test_front_mass_removed_leaves_no_steering_tendency() -> None:
    # Held at a lean, gravity turns the steering by -g K0[steer, lean]: into the fall, and then no longer.
    bicycle = load_bicycle("tms_table_8_1")
    changed = changed_bicycle(bicycle, load_intervention("front_mass_removed"))
    assert -bicycle.stiffness0[1, 0] > 0.03
    assert -changed.stiffness0[1, 0] <= 0.0


def test_removed_body_is_what_the_rest_lacks() -> None:
    # Put the cylinder back by hand: the whole front frame comes out again.
    bicycle = load_bicycle("tms_table_8_1")
    change = load_intervention("front_mass_removed")
    body, rest, whole = change.removed, changed_bicycle(bicycle, change).parameters, bicycle.parameters
    assert body is not None
    assert rest is not None
    assert whole is not None
    mass = rest.front_frame_mass + body.mass
    assert mass == pytest.approx(whole.front_frame_mass)
    x = (rest.front_frame_mass * rest.front_frame_x + body.mass * body.x) / mass
    z = (rest.front_frame_mass * rest.front_frame_z + body.mass * body.z) / mass
    assert (x, z) == pytest.approx((whole.front_frame_x, whole.front_frame_z))
    r, h, tilt = body.diameter / 2, body.length, whole.steer_axis_tilt
    across, along = body.mass * (3 * r * r + h * h) / 12, body.mass * r * r / 2
    zz = along * math.cos(tilt) ** 2 + across * math.sin(tilt) ** 2
    zz += rest.front_frame_inertia_zz
    zz += body.mass * (body.x - x) ** 2 + rest.front_frame_mass * (rest.front_frame_x - x) ** 2
    assert zz == pytest.approx(whole.front_frame_inertia_zz, rel=1e-9)
    yy = across + rest.front_frame_inertia_yy
    yy += body.mass * ((body.x - x) ** 2 + (body.z - z) ** 2)
    yy += rest.front_frame_mass * ((rest.front_frame_x - x) ** 2 + (rest.front_frame_z - z) ** 2)
    assert yy == pytest.approx(whole.front_frame_inertia_yy, rel=1e-9)


@pytest.mark.parametrize(
    "path", sorted([*FLOORS.glob("*.yaml"), *WHEELS.glob("*.yaml")]), ids=lambda p: p.stem
)
def test_every_number_of_floors_and_wheels_says_where_it_is_from(path: Any) -> None:
    import yaml

    document = yaml.safe_load(path.read_text())
    assert len(document.pop("description")) > 10
    for key, entry in document.items():
        first = entry["source"].split()[0].strip(":;,")
        assert first in ("published", "assumption", "a", "no", "the"), (key, entry)
    (load_floor if path.parent == FLOORS else load_wheels)(path.stem)


def test_published_resistance() -> None:
    assert load_floor("thin_rubber").rolling_resistance == 0.06
    assert load_floor("thick_rubber").rolling_resistance > load_floor("thin_rubber").rolling_resistance
    assert load_floor("linoleum").lateral_friction < load_floor("thin_rubber").lateral_friction


WRONG = {
    "unknown floor": ({"floor": "ice"}, "floor: unknown floor 'ice'; expected one of hard_wood"),
    "unknown wheels": ({"wheels": "square"}, "wheels: unknown wheels 'square'"),
    "unknown change": ({"intervention": "prayer"}, "intervention: unknown intervention 'prayer'"),
    "no such file": ({"floor": "nowhere.yaml"}, "nowhere.yaml: expected a readable YAML file"),
    "of another bicycle": (
        {"bicycle": "benchmark", "intervention": "front_mass_removed"},
        "front_frame_inertia_xx: expected zero or more",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_unknown_is_refused_in_one_line(go: Any, case: str) -> None:
    changes, said = WRONG[case]
    with pytest.raises(ParameterError, match=said) as error:
        go("gym_run", **changes)
    assert "\n" not in str(error.value)


BROKEN = {
    "negative": ("scrub: {value: 0.0,", "scrub: {value: -1.0,", "scrub: expected zero or more, found -1"),
    "no source": (
        "scrub: {value: 0.0, source: a definition}",
        "scrub: {value: 0.0}",
        "scrub: missing source",
    ),
    "bare number": ("scrub: {value: 0.0, source: a definition}", "scrub: 0.0", "scrub: expected keys"),
    "unknown": ("scrub:", "skrub:", "missing scrub"),
    "no limit": ("scrub: {value: 0.0,", "scrub: {value: null,", "scrub: expected a finite number"),
    "joints everywhere": ("joint_spacing: {value: null", "joint_spacing: {value: 0.0", "joint_spacing"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_floors_are_refused(case: str, tmp_path: Any) -> None:
    old, new, said = BROKEN[case]
    text = (FLOORS / "ideal.yaml").read_text()
    assert old in text
    (tmp_path / "mine.yaml").write_text(text.replace(old, new))
    with pytest.raises(ParameterError, match=said):
        load_floor(str(tmp_path / "mine.yaml"))


def test_interventions_are_read_with_care(tmp_path: Any) -> None:
    text = (FOLDER / "front_mass_removed.yaml").read_text()
    for old, new, said in (
        ("mass: 1.452", "mass: 3.0", "expected a front frame heavier than 3 kg"),
        ("steer_damper: 0.0", "steer_damper: -1.0", "steer_damper: expected zero or more"),
        ("parameters: {}", "parameters: 3", "parameters: expected names and numbers"),
        ("parameters: {}", "parameters: {hat: 3.0}", "hat: bicycle"),
    ):
        assert old in text
        (tmp_path / "mine.yaml").write_text(text.replace(old, new))
        with pytest.raises(ParameterError, match=said):
            changed_bicycle(load_bicycle("tms_table_8_1"), load_intervention(str(tmp_path / "mine.yaml")))
