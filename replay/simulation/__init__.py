"""Simulated flights with known truth, written as the telemetry that an autopilot would send."""

from mavkf.replay.simulation.flight import simulate
from mavkf.replay.simulation.parts import draw_noise
from mavkf.replay.simulation.sensors import SensorNoise

__all__ = ["SensorNoise", "draw_noise", "simulate"]
