"""What measures a run: inertial sensor, its orientation, the radio link, camera and wheel encoder.

Each takes the true motion and gives samples. Every error has a size of its own and 0 switches it off;
docs/sensors.md lists them with units, defaults and where the numbers come from. Each source of randomness has
its own generator (`Generator.spawn`), so that switching one error off leaves the draws of the others as they
were.
"""
