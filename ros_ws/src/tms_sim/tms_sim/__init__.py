"""Makes runs: scenarios, strike, sensors. Same scenario and seed, same samples, on the command line and in the node."""

__version__ = "0.1.0"
