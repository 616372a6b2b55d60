# ruff: noqa: E501
"""Recorded answers of the command line, against which a rebuilt inside is compared.

`python tests/golden/record.py --only 'bags/*'` runs the command lines below and stores what they print as
compact JSON under answers/. Long arrays are reduced to count, mean, root mean square, minimum and maximum.
The simulated runs and imported logs that the fits read are made once, in the folder given by --runs.
"""

from __future__ import annotations

import argparse
import contextlib
import fnmatch
import hashlib
import io
import json
import math
import re
import runpy
import sys
import tempfile
import time
import traceback
from collections.abc import Collection, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import yaml

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SCENARIOS = [
    "benchmark_strike",
    "delft_push",
    "gym_as_measured",
    "gym_linoleum",
    "gym_polyurethane",
    "gym_run",
    "gym_strikes",
    "gym_thick_rubber",
    "gym_wood",
    "tms_strike",
    "tms_strike_ideal",
]
BAGS = ("tms_strike", "benchmark_strike", "delft_push")
LOGS = {"delft_3": "eigen_normal_sil6.5n2_10.8kph.log", "delft_4": "eigen_normal_sil6.5n2_14.4kph.log"}
LONGEST = 16  # numbers in a list that is stored as it is
DROPPED = {"bag", "bags", "path", "output", "correlation", "config", "specs"}

FITS = {
    "default": "",
    "tests": "--hypotheses --budget",
    "som2011": "--estimator som2011",
    "white": "--noise white",
    "ar": "--noise ar",
    "oscillator": "--noise oscillator",
    "oscillator-stated": "--noise oscillator --oscillator 6,0.3,0.02",
    "noise-std": "--noise-std 0.02",
    "squares": "--loss squares",
    "huber": "--loss huber",
    "student": "--loss student_t",
    "huber-ar": "--loss huber --noise ar",
    "saturation-drop": "--gyroscope-range 0.35",
    "saturation-censor": "--saturation censor --gyroscope-range 0.35",
    "saturation-use": "--saturation use --gyroscope-range 0.35",
    "start": "--free initial_lean,initial_steer,initial_lean_rate,initial_steer_rate",
    "steer-rate": "--free initial_lean_rate,initial_steer_rate,lean_rate_bias,yaw_rate_bias",
    "friction": "--free initial_lean_rate,steer_coulomb_friction",
    "speed": "--free initial_lean_rate,speed",
    "resistance": "--free initial_lean_rate,rolling_resistance --speed-model decelerating",
    "strike-time": "--free initial_lean_rate,strike_time",
    "gain": "--free initial_lean_rate,lean_rate_gain",
    "damper": "--free initial_lean_rate,steer_damper",
    "mounting": "--free initial_lean_rate,mounting_pitch",
    "slip-free": "--free initial_lean_rate,slip_yaw_rate --slip-window 0.2 --slip yaw_offset",
    "slip-out": "--slip-window 0.2",
    "slip-offset": "--slip-window 0.2 --slip yaw_offset",
    "profile": "--intervals profile",
    "bootstrap": "--intervals bootstrap",
    "profile-speed": "--intervals profile --free initial_lean_rate,speed",
    "prior": "--prior lean_rate_bias=0,0.002",
    "prior-speed": "--free initial_lean_rate,speed --prior speed=3.6,0.05",
    "window-4": "--window 4",
    "window-4-ar": "--window 4 --noise ar",
    "lean-rate": "--channels lean_rate",
    "measured": "--speed-model measured",
    "constant": "--speed-model constant",
    "brake": "--speed-model measured --resistance rear_brake",
    "torque-ignored": "--steer-torque ignore",
    "torque-input": "--steer-torque input",
    "fixed": "--fix lean_rate_bias=0.001 --fix speed=3.55",
    "stated": "--strike 2.05",
    "som2011-window": "--estimator som2011 --estimator kalman_rts --window 1",
}
MODELS = {
    "show": "show",
    "matrices": "matrices",
    "eigenvalues": "eigenvalues --speed 4",
    "stability": "stability",
    "response": "response --speed 4 --lean-rate 0.3",
    "nonlinear": "response --speed 4 --lean-rate 0.3 --duration 1 --nonlinear",
    "slowing": "response --speed 4 --lean-rate 0.3 --deceleration 0.3 --resistance front_brake --gain 2",
    "urdf": "urdf",
    "changed": "eigenvalues --speed 4 --set steer_damper=0.5",
}
BICYCLES = [
    "benchmark",
    "counterexample_4b_decentering_spring",
    "counterexample_7_rear_steering",
    "delft_sbw",
    "delft_sbw_calibrated",
    "tms_eq_10_1",
    "tms_table_7_1",
    "tms_table_8_1",
]
CALIBRATE = (
    "fit calibrate {runs}/delft_3 {runs}/delft_4 --bicycle delft_sbw"
    " --near 15.73,26.01,35.77,56.82,65.27,74.71,83.71,94.24,101.87 --near 14.10,23.85,34.00,43.52,52.76,63.11,73.47,84.23"
    " --free rear_frame_inertia_xx,rear_frame_inertia_zz,rear_frame_inertia_xz,front_wheel_inertia_yy,steer_damper,steer_torque_gain"
    " --prior rear_frame_inertia_xx=1.64,0.36 --prior rear_frame_inertia_zz=1.94,0.76 --prior front_wheel_inertia_yy=0.1289,0.01"
    " -o {out}/mine.yaml --json"
)
TOGETHER = {
    "default": "{runs}/gym_strikes-1 bags/tms_strike",
    "biases": "{runs}/tms_strike-1 {runs}/tms_strike-2 {runs}/tms_strike-3 --share lean_rate_bias,yaw_rate_bias",
    "ar": "{runs}/gym_run-1 {runs}/gym_run-2 {runs}/gym_run-3 --share rolling_resistance --noise ar --speed-model decelerating",
    "laird": "{runs}/gym_strikes-2 --noise white --method dersimonian_laird --share lean_rate_bias",
    "prior": "{runs}/tms_strike-1 {runs}/tms_strike-2 --share speed --prior speed=3.6,0.1",
    "delft": "{runs}/delft_4 --near 14.10,23.85,34.00,43.52 --share steer_damper --free initial_lean_rate,initial_steer_rate",
}
STUDIES = {
    "bound": "bound tms_strike",
    "bound-gym": "bound gym_run --free initial_lean_rate,rolling_resistance",
    "campaign": "campaign tms_strike --vary strike.lean_rate=[0.2,0.4] --runs 2",
    "campaign-gym": "campaign gym_run --runs 2 --estimator kalman_rts --given",
    "strikes": "strikes --runs 1 --only push",
}


def cases() -> dict[str, str]:
    """Command lines by name; {runs}, {out} and {logs} stand for folders."""
    found = {
        f"bags/{bag}/{name}": f"fit run bags/{bag} --json {words}"
        for bag in BAGS
        for name, words in FITS.items()
    }
    runs = [f"{scenario}-{seed}" for seed in (1, 2, 3) for scenario in SCENARIOS]
    found |= {f"sim/{run}": f"sim run {run[:-2]} --seed {run[-1]} -o {{out}}/run" for run in runs}
    found |= {
        f"logs/{name}": f"bag import-csv {{logs}}/{log} --mapping delft_sbw -o {{out}}/run"
        for name, log in LOGS.items()
    }
    found |= {f"scenarios/{run}": f"fit run {{runs}}/{run} --json" for run in runs}
    for run in ("gym_run-1", "gym_strikes-1", "gym_as_measured-1"):
        found[f"scenarios/{run}-tests"] = f"fit run {{runs}}/{run} --json --hypotheses --budget"
        found[f"scenarios/{run}-som2011"] = f"fit run {{runs}}/{run} --json --estimator som2011 --window 4"
        found[f"scenarios/{run}-friction"] = (
            f"fit run {{runs}}/{run} --json --free initial_lean_rate,steer_coulomb_friction"
        )
    for log in LOGS:
        for bicycle in ("delft_sbw", "delft_sbw_calibrated"):
            found[f"delft/{log}-{bicycle}"] = f"fit run {{runs}}/{log} --json --bicycle {bicycle}"
        found[f"delft/{log}-one"] = f"{found[f'delft/{log}-delft_sbw_calibrated']} --free initial_lean_rate"
    found["delft/delft_3-three"] = (
        "fit run {runs}/delft_3 --json --free initial_lean_rate,initial_steer_rate,lean_rate_bias"
    )
    found |= {f"together/{name}": f"fit together {words} --json" for name, words in TOGETHER.items()}
    found["calibrate/delft"] = CALIBRATE
    found["calibrate/matrices"] = (
        "fit calibrate bags/tms_strike {runs}/tms_strike-1 {runs}/tms_strike-2 {runs}/tms_strike-3"
        " --free K0_lean_steer,C1_lean_steer --each initial_lean_rate -o {out}/mine.yaml --json"
    )
    found["calibrate/one"] = (
        "fit calibrate bags/delft_push {runs}/delft_push-1 {runs}/delft_push-2 {runs}/delft_push-3 --free steer_damper -o {out}/mine.yaml --json"
    )
    found |= {
        f"model/{b}/{name}": f"model {words} {b} --json" for b in BICYCLES for name, words in MODELS.items()
    }
    found |= {
        f"model/{b}/linearity": f"model linearity --speed 5 {b} --json" for b in ("benchmark", "delft_sbw")
    }
    found["model/delft_sbw_calibrated/uncertainty"] = (
        "model stability delft_sbw_calibrated --uncertainty --samples 200 --json"
    )
    for bag in (
        [f"bags/{name}" for name in BAGS]
        + [f"{{runs}}/{s}-1" for s in SCENARIOS]
        + [f"{{runs}}/{log}" for log in LOGS]
    ):
        label = bag.replace("{runs}/", "").replace("/", "-")
        found |= {f"bag/{label}-{word}": f"bag {word} {bag} --json" for word in ("info", "check")}
    for bag in ("bags/tms_strike", "bags/delft_push", "{runs}/gym_run-1", "{runs}/gym_as_measured-1"):
        found[f"report/{Path(bag).name}"] = f"fit report {bag} -o {{out}}/report.html"
    found |= {f"study/{name}": f"study {words} --json" for name, words in STUDIES.items()}
    return found


def reduced(value: Any) -> Any:
    """A document without bulk: long arrays as summaries, no correlations, no paths."""
    if isinstance(value, dict):
        return {key: reduced(one) for key, one in value.items() if key not in DROPPED}
    if isinstance(value, list):
        flat = list(_flat(value))
        if len(flat) > LONGEST and not any(isinstance(one, dict) for one in flat):
            numbers = [
                float(one) for one in flat if isinstance(one, (int, float)) and not isinstance(one, bool)
            ]
            summary: dict[str, Any] = {"count": len(flat), "numbers": len(numbers)}
            if numbers:
                rms = math.sqrt(math.fsum(one * one for one in numbers) / len(numbers))
                summary |= {
                    "mean": math.fsum(numbers) / len(numbers),
                    "rms": rms,
                    "min": min(numbers),
                    "max": max(numbers),
                }
            return {"summary": summary}
        return [reduced(one) for one in value]
    return value


def _flat(value: list[Any]) -> Iterator[Any]:
    for one in value:
        if isinstance(one, list):
            yield from _flat(one)
        else:
            yield one


def answer(command: str, runs: Path, logs: Path) -> tuple[Any, float]:
    """What a command line answers, reduced, and how long it took [s]."""
    with tempfile.TemporaryDirectory(prefix="golden-") as folder:
        tool, *words = command.format(runs=runs, logs=logs, out=folder).split()
        text, errors, code, began = io.StringIO(), io.StringIO(), 0, time.perf_counter()
        sys.argv = [tool, *words]
        with contextlib.redirect_stdout(text), contextlib.redirect_stderr(errors):
            try:
                runpy.run_module(f"tms_{tool}", run_name="__main__", alter_sys=False)
            except SystemExit as stop:
                code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
            except Exception:
                code = 1
                traceback.print_exc()
        seconds = time.perf_counter() - began
        found: dict[str, Any] = {"exit": code}
        if errors.getvalue():
            found["errors"] = _without(errors.getvalue(), folder, runs, logs)
        if "--json" in words and text.getvalue():
            found["document"] = json.loads(_without(text.getvalue(), folder, runs, logs))
        for path in sorted(Path(folder).rglob("*.*")):
            if path.suffix in (".mcap", ".yaml") and path.parent.name == "run":
                found[path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
            elif path.suffix == ".yaml":
                found[path.name] = json.loads(
                    json.dumps(yaml.safe_load(_without(path.read_text(), folder, runs, logs)), default=str)
                )
            elif path.suffix == ".html":
                data = re.search(r'id="report-data">(.*?)</script>', path.read_text(), re.DOTALL)
                found[path.name] = json.loads(data.group(1)) if data else None
    return reduced(found), seconds


def _without(text: str, folder: str, runs: Path, logs: Path) -> str:
    for name, path in {"OUT": folder, "RUNS": str(runs), "LOGS": str(logs), "ROOT": str(ROOT)}.items():
        text = text.replace(path, name)
    return text


def prepare(wanted: dict[str, str], runs: Path, logs: Path) -> None:
    """Make the bags in the folder of runs that the wanted commands read and that aren't there yet."""
    for name, command in cases().items():
        group, _, run = name.partition("/")
        needed = group in ("sim", "logs") and any(f"{{runs}}/{run}" in one for one in wanted.values())
        if needed and not (runs / run).exists():
            with tempfile.TemporaryDirectory(dir=runs) as folder:
                tool, *words = command.format(out=folder, logs=logs).split()
                sys.argv = [tool, *words]
                with contextlib.suppress(SystemExit), contextlib.redirect_stdout(sys.stderr):
                    runpy.run_module(f"tms_{tool}", run_name="__main__")
                (Path(folder) / "run").rename(runs / run)


def answers(options: argparse.Namespace, without: Collection[str] = ()) -> Iterator[tuple[str, Any, float]]:
    """Names, answers and seconds of the chosen cases, as they are finished, with progress on stderr."""
    wanted = {name: words for name, words in cases().items() if chosen(name, options) and name not in without}
    if not (options.logs / LOGS["delft_3"]).exists() and any(name.startswith("logs/") for name in wanted):
        print(f"no logs in {options.logs}: their import is left out", file=sys.stderr)
        wanted = {name: words for name, words in wanted.items() if not name.startswith("logs/")}
    options.runs.mkdir(parents=True, exist_ok=True)
    prepare(wanted, options.runs, options.logs)
    with ProcessPoolExecutor(options.jobs) as pool:
        running = {
            pool.submit(answer, words, options.runs, options.logs): name for name, words in wanted.items()
        }
        for count, done in enumerate(as_completed(running), 1):
            found, seconds = done.result()
            print(f"\r{count}/{len(running)} {running[done]:60.60}", end="", file=sys.stderr, flush=True)
            yield running[done], found, seconds
    print(file=sys.stderr)


def path_of(name: str, options: argparse.Namespace) -> Path:
    """File of an answer."""
    return options.answers / f"{name.replace('/', '.')}.json"


QUICK = (
    "bags/tms_strike/default", "bags/tms_strike/tests", "bags/tms_strike/ar", "bags/tms_strike/speed", "bags/delft_push/default",
    "bags/tms_strike/friction", "bags/benchmark_strike/som2011", "scenarios/gym_run-1",
    "sim/tms_strike-1", "together/biases", "calibrate/one", "model/benchmark/[!l]*", "bag/bags-tms_strike-*", "report/tms_strike",
)  # fmt: skip


def chosen(name: str, options: argparse.Namespace) -> bool:
    """Whether --quick and --only ask for a case."""
    patterns = [f"*{one}*" for one in options.only] or (["*"] if not options.quick else [])
    return any(fnmatch.fnmatch(name, one) for one in [*patterns, *(QUICK if options.quick else ())])


def parser(description: str) -> argparse.ArgumentParser:
    """Options that recording and comparing have in common."""
    found = argparse.ArgumentParser(description=description)
    found.add_argument(
        "--only", action="append", default=[], metavar="PATTERN", help="part of names; may be repeated"
    )
    found.add_argument("--quick", action="store_true", help="a subset of under a minute")
    found.add_argument("--jobs", type=int, default=2)
    found.add_argument(
        "--runs",
        type=Path,
        default=ROOT.parent / "golden-runs",
        help="folder of simulated runs (%(default)s)",
    )
    found.add_argument(
        "--logs", type=Path, default=ROOT.parent / "shared/data/delft_sbw", help="Delft logs (%(default)s)"
    )
    found.add_argument("--answers", type=Path, default=HERE / "answers")
    return found


if __name__ == "__main__":
    declared = parser("Record the answers of the command line.")
    declared.add_argument("--missing", action="store_true", help="only those that are not recorded yet")
    options = declared.parse_args()
    options.runs = options.runs.resolve()
    options.answers.mkdir(exist_ok=True)
    recorded = {name for name in cases() if path_of(name, options).exists()}
    for name, found, _ in answers(options, recorded if options.missing else ()):
        path_of(name, options).write_text(json.dumps(found, separators=(",", ":")) + "\n")
