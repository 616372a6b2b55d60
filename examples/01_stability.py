"""Where is a bicycle self-stable, and how fast does it fall otherwise?

Run with: ./tms shell -c 'python examples/01_stability.py'
"""

from tms_model import bicycle_names, eigenvalues, load_bicycle, stability

for name in bicycle_names():
    bicycle = load_bicycle(name)
    answer = stability(bicycle)
    ranges = " and ".join(f"{low:.3f} to {high:.3f} m/s" for low, high in answer.stable_speed_ranges)
    fastest = eigenvalues(bicycle, 1.0).real.max()
    print(f"{name:14} self-stable: {ranges or 'nowhere'}; at 1 m/s a fall grows as exp({fastest:.2f} t)")
