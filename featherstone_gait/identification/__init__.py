"""Servo parameters from recordings."""

from .fit import MOTOR_OFF as MOTOR_OFF
from .fit import (
    Identification,
    Recording,
    changed,
    identify,
    predict,
    prediction_error,
    read_recording,
    write_recording,
)

__all__ = [
    "Identification",
    "Recording",
    "changed",
    "identify",
    "predict",
    "prediction_error",
    "read_recording",
    "write_recording",
]
