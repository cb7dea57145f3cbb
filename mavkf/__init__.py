"""mavkf: the fused pose of a drone from its MAVLink telemetry."""

__version__ = "0.1.0"
