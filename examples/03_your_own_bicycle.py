"""What if? The two-mass-skate bicycle with another trail, parameter by parameter.

Run with: ./tms shell -c 'python examples/03_your_own_bicycle.py'
"""

from dataclasses import replace

from tms_model import ParameterError, assemble, load_bicycle, stability

parameters = load_bicycle("tms_table_8_1").parameters
assert parameters is not None
for trail in (-0.012, -0.008, -0.004, 0.0, 0.004):
    bicycle = assemble("what_if", replace(parameters, trail=trail))
    ranges = stability(bicycle).stable_speed_ranges
    where = f"self-stable from {ranges[0][0]:.3f} m/s" if ranges else "nowhere self-stable"
    print(f"trail {1000 * trail:+5.0f} mm: {where}")

try:
    replace(parameters, rear_frame_mass=-1.0)
except ParameterError as error:
    print("refused:", error)
