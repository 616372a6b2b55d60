"""Runs without their truth: a bag that holds what an experimenter has, and a file beside it with the rest."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from tms_bag import Record, topics
from tms_bag.event import events
from tms_bag.samples import RunInfo
from tms_model.yaml_text import load_yaml

from tms_sim import __version__
from tms_sim.run import SimulatedRun
from tms_sim.scenario import Scenario

TRUTH = (topics.STATE, topics.EVENTS)  # topics that no experimenter has
# What an experimenter knows: the bicycle as designed, where it runs, and the sensors as their papers say.
KNOWN = (
    "bicycle", "floor", "wheels", "imu.grade", "imu.rate", "imu.raw_rate", "imu.position",
    "imu.orientation_deg", "speed_sensor.rate",
)  # fmt: skip


def truth_path(bag: str | os.PathLike[str]) -> Path:
    """The file with the truth of a blind bag: BAG.truth.json."""
    path = Path(bag)
    return path.with_name(f"{path.name}.truth.json")


def blinded(run: SimulatedRun, scenario: Scenario) -> SimulatedRun:
    """The same run with the information that an experimenter could write down; `records` still has all."""
    known = Scenario("", {key: scenario.values[key] for key in KNOWN})
    document = load_yaml(known.to_yaml())
    del document["scenario"]
    info = replace(
        run.info,
        speed=float("nan"),
        seed=-1,
        source="tms_sim",
        configuration=yaml.safe_dump(document, sort_keys=False),
    )
    return replace(run, info=info)


def blind_records(run: SimulatedRun) -> Iterator[Record]:
    """The messages of a run but those of the truth."""
    hidden = tuple("/" + topic for topic in TRUTH)
    return (record for record in run.records() if record.topic not in hidden)


def blind_custom_data(info: RunInfo) -> dict[str, str]:
    """What a blind bag's metadata tell."""
    return {"configuration": info.configuration, "source": info.source, "version": info.version}


def truth_text(run: SimulatedRun, scenario: Scenario) -> str:
    """The truth of a run, as JSON."""
    return json.dumps(_document(run, scenario), indent=1, allow_nan=False) + "\n"


def _document(run: SimulatedRun, scenario: Scenario) -> dict[str, Any]:
    state = run.state
    columns = {
        name: np.asarray(value).tolist()
        for name, value in vars(state).items()
        if name != "state" and isinstance(value, np.ndarray)
    }
    for number, name in enumerate(("lean", "steer", "lean_rate", "steer_rate")):
        columns[name] = state.state[:, number].tolist()
    return {
        "scenario": scenario.name,
        "version": __version__,
        "seed": scenario.integer("seed"),
        "configuration": {k: list(v) if isinstance(v, tuple) else v for k, v in scenario.values.items()},
        "start_ns": run.info.start_ns,
        "end": run.trajectory.end,
        "ended_by": run.trajectory.ended_by,
        "events": [
            {
                "time_ns": one.time_ns,
                "kind": one.kind,
                "text": one.text,
                "duration": one.duration,
                "figures": dict(one.figures),
            }
            for one in events(record for record in run.records() if record.topic == "/" + topics.EVENTS)
        ],
        "state": columns,
    }
