"""Makes runs: scenarios, strike, sensors. Same scenario and seed: same samples, in a bag or from the node."""

__version__ = "0.1.0"
