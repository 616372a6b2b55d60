"""Strike a simulated bicycle, write a bag, and find out how hard it was hit.

Run with: ./tms shell -c 'python examples/02_simulate_and_fit.py'
"""

import tempfile
from pathlib import Path

import numpy as np
from tms_bag import BagWriter, read_recording, topics
from tms_fit.recording_fit import bicycle_of, fit_recording
from tms_fit.settings import Settings
from tms_sim.run import simulate
from tms_sim.scenario import load_scenario

scenario = load_scenario("tms_strike", {"strike.lean_rate": 0.4, "seed": 3})
run = simulate(scenario, np.random.default_rng(3))
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "bag"
    with BagWriter(path, custom_data=run.custom_data()) as bag:
        for record in run.records():
            bag.write(record, topics.QOS[record.topic.removeprefix("/")])
    recording = read_recording(path)

fit = fit_recording(recording, bicycle_of(recording, None), Settings())
for strike in fit.strikes:
    for estimate in strike.estimates:
        low, high = estimate.ci95[0]
        print(f"{estimate.estimator}: {estimate.values[0]:.4f} rad/s, 95 % [{low:.4f}, {high:.4f}], true 0.4")
