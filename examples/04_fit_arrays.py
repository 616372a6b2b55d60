"""Fit gyroscope readings that are in no bag: times, angular velocities and a speed as arrays.

Run with: ./tms shell -c 'python examples/04_fit_arrays.py'
"""

import numpy as np
from tms_fit import fit
from tms_model import linear_system, load_bicycle, response, yaw_rate

# Stands for a logger's file: the free response of a bicycle at 4.6 m/s, struck to 0.4 rad/s after 1.995 s.
system = linear_system(load_bicycle("tms_eq_10_1"), 4.6)
states = response(system, np.array([0.0, 0.0, 0.4, 0.0]), np.arange(600) / 200.0)[1::2]  # 5 ms after it, ...
lean, lean_rate, yaw = states[:, 0], states[:, 2], -yaw_rate(system, states)  # yaw about z up
angular_velocity = np.random.default_rng(1).normal(0.0, 0.02, (500, 3))  # x forward, y left, z up
angular_velocity[200:] += np.stack([lean_rate, yaw * np.sin(lean), yaw * np.cos(lean)], axis=1)

result = fit(np.arange(500) / 100.0, angular_velocity, speed=4.6, bicycle="tms_eq_10_1")
print(result)
print(result[0]["initial_lean_rate"])
