"""What a sample costs the live fit, against filterpy's bare filter; memory of a long stream.

See benchmarks/README.md.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np
from filterpy.kalman import KalmanFilter
from measure import Timing, by_processor, in_turn, print_machine
from numpy.typing import NDArray
from tms_bag import Record, conversion, topics
from tms_bag.samples import ImuSamples, RunInfo, SpeedSamples
from tms_fit.kalman.ekf import FilterStep
from tms_fit.messages import filter_state_record
from tms_fit.settings import Settings
from tms_fit.streaming.live_fit import LiveFit
from tms_fit.streaming.live_run import LiveRun
from tms_model import discretise, linear_system, load_bicycle, response, yaw_rate
from tms_model.frames import flip_axes, quaternion

Array = NDArray[np.float64]
SECOND, RATE, SPEED, NOISE = 1_000_000_000, 100, 3.6, 0.02  # [ns], [Hz], [m/s], [rad/s]
INFO = RunInfo(start_ns=SECOND, bicycle="tms_eq_10_1", speed=SPEED)
PERIOD = 1500  # samples between strikes


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few repeats and small sizes: does it run?")
    parser.add_argument(
        "--stream", type=int, default=0, metavar="N", help="memory over N samples, with strikes"
    )
    asked = parser.parse_args()
    print_machine(("numpy", "filterpy"))
    if asked.stream:
        print_memory(asked.stream)
        return
    count, repeats = (150, 3) if asked.quick else (2000, 11)
    for rate in (100,) if asked.quick else (100, 1000):
        print(f"\n{rate} Hz, processor time")
        print_costs(count, repeats, rate)
        print_peaks(rate)


def print_costs(count: int, repeats: int, rate: int) -> None:
    """What a sample costs, and its parts."""
    quiet, struck = samples(count, 0.0, rate=rate), samples(count, 0.5, rate=rate)
    messages, swinging = encoded(quiet), encoded(struck)
    steps = [one for one in fed(quiet, Settings()).results() if isinstance(one, FilterStep)]
    records = [Record("/" + topics.IMU, topics.TYPES[topics.IMU], 0, data) for kind, data in messages
               if kind == topics.IMU]  # fmt: skip
    ways = {
        "filterpy, predict, update, Mahalanobis": lambda: by_filterpy(quiet),
        "LiveRun, linear": lambda: fed(quiet, Settings()),
        "LiveRun, extended": lambda: fed(quiet, Settings(filter="extended")),
        "reading the messages": lambda: [conversion.imu_reading(record) for record in records],
        "writing the messages": lambda: [filter_state_record(step) for step in steps],
        "LiveFit, all of these, linear": lambda: taken(messages, 0.0),
        "LiveFit, strikes, final fits": lambda: taken(swinging, 0.0),
        "LiveFit, strikes, final fits and previews": lambda: taken(swinging, 0.25),
    }
    timings = by_processor(in_turn(ways, repeats))
    print(f"medians of {repeats} repeats, quartiles in brackets; {count} IMU samples, {count // 5} speeds")
    for timing in timings.values():
        print_one(timing, timings["filterpy, predict, update, Mahalanobis"], count)


def print_one(timing: Timing, peer: Timing, count: int) -> None:
    """One line."""
    low, high = timing.quartiles
    print(
        f"  {timing.name:44} {1e3 * timing.median:10.3f} ms  ({1e3 * low:.3f} to {1e3 * high:.3f})"
        f"  {1e6 * timing.median / count:8.1f} us a sample  {timing.median / peer.median:6.1f} x filterpy"
    )


def print_peaks(rate: int) -> None:
    """How long one message holds up the next: the shortest of three times each, over 12 s with a strike."""
    messages = encoded(samples(12 * rate, 0.5, rate=rate))
    for preview in (0.0, 0.25):
        spent = np.full(len(messages), np.inf)
        for _ in range(3):
            fit = LiveFit(Settings(), preview_period=preview)
            for row, (topic, data) in enumerate(messages):
                start = time.thread_time()
                fit.process(topic, data)
                spent[row] = min(spent[row], time.thread_time() - start)
        median, high, higher, most = 1e3 * np.percentile(spent, [50, 99, 99.9, 100])
        print(
            f"  a message, previews {'on' if preview else 'off':3}: median {median:.3f} ms, 99 % {high:.3f},"
            f" 99.9 % {higher:.3f}, longest {most:.1f} ms"
        )


def print_memory(count: int) -> None:
    """Largest resident memory, and processor time for each sample, after each tenth of a stream."""
    fit, rng, start_ns = LiveFit(Settings()), np.random.default_rng(1), SECOND
    (info,) = conversion.run_info_records(INFO)
    fit.process(topics.RUN_INFO, info.data)
    done, shown, spent, since = 0, 0, 0.0, 0
    while done < count:
        messages = encoded(samples(PERIOD, 0.5, start_ns, rng))[1:]
        start = time.process_time()
        for topic, data in messages:
            fit.process(topic, data)
        spent += time.process_time() - start
        done, start_ns = done + PERIOD, start_ns + PERIOD * (SECOND // RATE)
        if done * 10 // count > shown:
            shown = done * 10 // count
            used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
            each, spent, since = 1e6 * spent / (done - since), 0.0, done
            strikes = fit.counts["strikes"]
            print(
                f"  {done:9d} samples, {strikes:5d} strikes: {used:8.1f} MiB, {each:6.1f} us a sample",
                flush=True,
            )


def samples(
    count: int,
    lean_rate: float,
    start_ns: int = SECOND,
    rng: np.random.Generator | None = None,
    rate: int = RATE,
) -> ImuSamples:
    """A ride that is struck a third into it, in axes of the sensor."""
    times = np.arange(count) / rate
    system = linear_system(load_bicycle(INFO.bicycle), SPEED)
    states = np.zeros((count, 4))
    after = np.arange(count) >= count // 3
    states[after] = response(system, np.array([0.0, 0.0, lean_rate, 0.0]), times[after] - times[after][0])
    rates = np.zeros((count, 3))
    rates[:, 0], rates[:, 2] = states[:, 2], yaw_rate(system, states)
    rates += NOISE * (rng or np.random.default_rng(1)).standard_normal(rates.shape)
    stamps = start_ns + np.arange(count) * (SECOND // rate)
    return ImuSamples(stamps, flip_axes(rates), np.zeros_like(rates), np.full(3, NOISE**2))


def encoded(imu: ImuSamples) -> list[tuple[str, bytes]]:
    """The announcement, then all messages in the order of their stamps."""
    stamps = imu.time_ns[::5]
    speeds = conversion.speed_records(SpeedSamples(stamps, np.full(len(stamps), SPEED)))
    records = sorted([*speeds, *conversion.imu_records(imu)], key=lambda record: record.time_ns)
    announced = next(iter(conversion.run_info_records(INFO)))
    return [(record.topic.removeprefix("/"), record.data) for record in (announced, *records)]


def fed(imu: ImuSamples, settings: Settings) -> LiveRun:
    """The fit after all samples, without messages."""
    online = LiveRun(load_bicycle(INFO.bicycle), settings, quaternion(0.0, 0.0, 0.0), SPEED)
    for number, stamp in enumerate(imu.time_ns.tolist()):
        if number % 5 == 0:
            online.add_speed(stamp, SPEED)
        online.add_imu(stamp, imu.angular_velocity[number], imu.angular_velocity_variance)
    return online


def taken(messages: list[tuple[str, bytes]], preview_period: float) -> int:
    """Number of answers."""
    fit = LiveFit(Settings(), preview_period=preview_period)
    return sum(len(fit.process(topic, data)) for topic, data in messages)


def by_filterpy(imu: ImuSamples) -> float:
    """Sum of the Mahalanobis distances; the matrices are made once."""
    system = linear_system(load_bicycle(INFO.bicycle), SPEED)
    kalman = KalmanFilter(dim_x=4, dim_z=2)
    kalman.F, kalman.Q = discretise(system, 1.0 / RATE)[0], 1e-4 * np.eye(4)
    kalman.H, kalman.R = np.stack([np.eye(4)[2], system.yaw]), NOISE**2 * np.eye(2)
    measured, total = imu.angular_velocity[:, [0, 2]] * [1.0, -1.0], 0.0
    for sample in measured:
        kalman.predict()
        kalman.update(sample.reshape(2, 1))
        total += kalman.mahalanobis
    return total


if __name__ == "__main__":
    main()
