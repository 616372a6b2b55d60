"""The whole pipeline in one go: simulator and recorder nodes, player and estimator nodes, the offline fit."""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from tms_bag import BagReader, RecordingError, read_recording
from tms_bag.messages import deserialize
from tms_fit.figure3b import figure_3b
from tms_fit.messages import ESTIMATE, ESTIMATE_TYPE, FILTER_STATE
from tms_fit.output import to_json
from tms_fit.recording_fit import RecordingFit, bicycle_of, fit_recording
from tms_fit.settings import Settings
from tms_fit.streaming.live_fit import INPUTS
from tms_fit.strike_fit import StrikeFit
from tms_model.atomic_write import atomic_write
from tms_model.command_line import finite
from tms_model.figures.saving import save_figure
from tms_sim.run import SimulatedRun, simulate
from tms_sim.scenario import load_scenario

from tms_study.processes import NodeProcess, own_domain

RATE = 4.0  # simulated seconds per real second
PATIENCE = 300.0  # [s], longest wait for a step; on a busy machine a node takes 20 s to start


def demo(output: Path, scenario: str, seed: int) -> str:
    """Run the demo into a folder, replacing an earlier one; return the table to print.

    The folder appears whole or not at all. Raises RecordingError or ParameterError with what went wrong.
    """
    bicycle = load_scenario(scenario).text("bicycle")
    with _folder(output) as folder:
        (folder / "log").mkdir()
        with own_domain():
            _say("simulator and recorder: a strike, live over DDS")
            _record(folder, scenario, seed)
            _say("player and estimator: the recorded bag, replayed")
            _estimate(folder, bicycle)
        _say("offline fit of the same bag")
        recording = read_recording(folder / "bag")
        fit = fit_recording(recording, bicycle_of(recording, bicycle), Settings())
        document = {**to_json(fit), "bag": str(output / "bag")}
        atomic_write(folder / "estimate.json", (json.dumps(finite(document), indent=1) + "\n").encode())
        save_figure(figure_3b(fit), folder / "figure_3b.png")
        live = _live_estimates(folder / "live")
    run = simulate(load_scenario(scenario, {"seed": seed}), np.random.default_rng(seed))
    return _table(fit, live, run, output)


@contextmanager
def _folder(output: Path) -> Iterator[Path]:
    """A new folder that takes the place of `output` at the end, and is gone when something fails."""
    unfinished = output.with_name(f".{output.name}.{os.getpid()}.unfinished")
    marker = output / "estimate.json"
    if output.exists() and not (output.is_dir() and (marker.exists() or not any(output.iterdir()))):
        raise RecordingError(
            f"{output}: expected a new folder or one made by a demo, found other things; choose another --out"
        )
    try:
        unfinished.mkdir(parents=True)
        yield unfinished
        if output.exists():
            shutil.rmtree(output)
        unfinished.rename(output)
    except OSError as error:
        raise RecordingError(f"{output}: expected a place to write, found: {error.strerror}") from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _record(folder: Path, scenario: str, seed: int) -> None:
    recorder = NodeProcess("tms_bag", "recorder", {"output": folder / "bag"}, folder / "log" / "recorder.log")
    parameters = {
        "scenario": scenario,
        "seed": seed,
        "rate": RATE,
        "wait_for_subscribers": 1,
        "wait_timeout": PATIENCE,
        "display_rate": 0.0,  # the bag holds what can be made again byte for byte
    }
    simulator = NodeProcess("tms_sim", "simulator", parameters, folder / "log" / "simulator.log")
    try:
        simulator.wait(PATIENCE)
        recorder.stop()
    finally:
        simulator.kill()
        recorder.kill()


def _estimate(folder: Path, bicycle: str) -> None:
    outputs = f"[{ESTIMATE},{FILTER_STATE}]"
    listener = NodeProcess(
        "tms_bag",
        "recorder",
        {"output": folder / "live", "topics": outputs},
        folder / "log" / "live_recorder.log",
    )
    estimator = NodeProcess(
        "tms_fit", "estimator", {"bicycle": bicycle, "idle": 2.0}, folder / "log" / "estimator.log"
    )
    try:
        for topic in (ESTIMATE, FILTER_STATE):
            listener.wait_for(f"recording /{topic}", PATIENCE)
        with BagReader(folder / "bag") as bag:
            inputs = [topic.name for topic in bag.topics if topic.count and topic.name.lstrip("/") in INPUTS]
        parameters = {
            "bag": folder / "bag",
            "rate": RATE,
            "topics": f"[{','.join(inputs)}]",
            "wait_for_subscriptions": len(inputs),
            "wait_timeout": PATIENCE,
        }
        player = NodeProcess("tms_bag", "player", parameters, folder / "log" / "player.log")
        try:
            player.wait(PATIENCE)
        finally:
            player.kill()
        _wait_for_estimates(folder / "live")
        estimator.stop()
        listener.stop()
    finally:
        estimator.kill()
        listener.kill()


def _wait_for_estimates(bag: Path) -> None:
    """Until the recorded estimates have reached the disk."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        if _live_estimates(bag):
            return
        time.sleep(0.1)
    raise RecordingError(f"expected an estimate from the estimator node within {PATIENCE:g} s, found none")


def _live_estimates(bag: Path) -> dict[str, tuple[float, float, float]]:
    """Initial lean rate and interval of the first strike, by estimator."""
    found: dict[str, tuple[float, float, float]] = {}
    with BagReader(bag) as reader:
        there = [
            topic.name for topic in reader.topics if topic.name == f"/{ESTIMATE}"
        ]  # none: not written yet
        for record in reader.records(there) if there else ():
            message = deserialize(record.data, ESTIMATE_TYPE)
            if message.final and "initial_lean_rate" in message.names and message.estimator not in found:
                i = message.names.index("initial_lean_rate")
                found[message.estimator] = (message.values[i], message.ci95_low[i], message.ci95_high[i])
    return found


def _table(
    fit: RecordingFit, live: dict[str, tuple[float, float, float]], run: SimulatedRun, output: Path
) -> str:
    strike = fit.strikes[0]
    when, true = true_lean_rate(run, strike)
    lines = ["", f"initial lean rate [rad/s], {fit.bicycle.name}"]
    lines.append(f"  {'true':24} {true:9.5f}   at {when:.4f} s, the start of the free response")
    for estimate in strike.estimates:
        index = estimate.names.index("initial_lean_rate")
        value, (low, high) = estimate.values[index], estimate.ci95[index]
        lines.append(f"  {estimate.estimator:24} {value:9.5f}   95 % [{low:.5f}, {high:.5f}]")
        if estimate.estimator in live:
            value, low, high = live[estimate.estimator]
            name = f"{estimate.estimator}, live node"
            lines.append(f"  {name:24} {value:9.5f}   95 % [{low:.5f}, {high:.5f}]")
    lines += ["", "look at"]
    texts = {
        "figure_3b.png": "measured and predicted",
        "estimate.json": "all numbers",
        "bag": "the recording",
    }
    width = max(len(str(output / name)) for name in texts)
    lines += [f"  {output / name!s:{width}}  {text}" for name, text in texts.items()]
    return "\n".join(lines)


def true_lean_rate(run: SimulatedRun, strike: StrikeFit) -> tuple[float, float]:
    """Instant [s since the run's start] that an initial lean rate is about, and the true lean rate there.

    The instant is the true end of the impulse where the fit estimates it, with its uncertainty in the
    interval, or where the free response was taken to begin earlier; else the start of the free response. The
    state in the bag can't tell: between two of its samples the lean rate changes by up to 0.2 rad/s.
    """
    start = (strike.start_ns - run.info.start_ns) / 1e9
    ends = [one.time + one.duration for one in run.trajectory.events if one.kind == "strike"]
    end = min(ends, key=lambda one: abs(one - start), default=start)
    uncertain = strike.window is not None and strike.window.delay_std > 0.0
    instant = end if uncertain else max(start, end)
    return instant, float(run.trajectory.at(np.array([instant])).lean_rate[0])


def _say(text: str) -> None:
    print(f"demo: {text}", file=sys.stderr)
