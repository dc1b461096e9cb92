"""Servo parameters from recordings."""

from .fit import Identification, changed, identify, predict, prediction_error
from .recording import MOTOR_OFF as MOTOR_OFF
from .recording import Recording, read_recording, write_recording

__all__ = [
    "Identification", "Recording", "changed", "identify", "predict", "prediction_error", "read_recording",
    "write_recording",
]  # fmt: skip
