"""ftcal: in situ calibration of six-axis force/torque sensors inside a robot."""

__version__ = "0.1.0"
