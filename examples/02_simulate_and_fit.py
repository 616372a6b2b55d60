"""Strike a simulated bicycle, write a bag, and estimate how hard it was hit.

Run with: ./tms shell -c 'python examples/02_simulate_and_fit.py'
"""

import tempfile
from pathlib import Path

from tms_bag import read_recording
from tms_fit import fit_recording
from tms_sim import simulate

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "bag"
    simulate("tms_strike", seed=3, strike__lean_rate=0.4).write(path)
    recording = read_recording(path)

for strike in fit_recording(recording):
    for estimate in strike.estimates:
        print(f"{estimate.estimator}: {estimate['initial_lean_rate']}, true 0.4")
