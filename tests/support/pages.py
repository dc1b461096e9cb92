"""Runs made by hand, and what is in a page."""

import json
import re

import numpy as np

from featherstone_gait import Trajectory, load_robot
from featherstone_gait.view.shown import in_posture

WEIGHT = 9.81


def data_of(page):
    """The numbers of a page."""
    return json.loads(re.search(r'id="data">(.*?)</script>', page, re.DOTALL)[1])


def humanoid():
    return load_robot("humanoid", locked="simplified")


def walking(model, duration=2.0, dt=0.01, speed=0.2, **how):
    """A humanoid that slides along x with its joints swinging, its weight on all points alike."""
    time = np.arange(round(duration / dt) + 1) * dt
    still = in_posture(model)
    n = len(model.joint_names)
    q = 0.2 * np.sin(2.0 * np.pi * time[:, None] + np.arange(n))
    base = np.repeat(still["base_q"], len(time), axis=0)
    base[:, 0] += speed * time
    half = 0.25 * np.sin(time)  # it turns about z
    base[:, 3], base[:, 6] = np.cos(half), np.sin(half)
    force = np.zeros((len(time), len(model.contacts), 3))
    force[:, :, 0] = WEIGHT * model.mass / len(model.contacts)
    energy = np.cumsum(np.ones((len(time), n, 8)), axis=0) * dt
    channels = {"time": time, "q": q, "base_q": base, "contact_force": force, "energy": energy, "torque": 0.1 * q}
    told = {"robot": model.name, "joints": list(model.joint_names), "servos": "mipsd"}
    settings = {"status": "ok", "message": "", "end_time": float(time[-1]), "info": told} | how
    return Trajectory(channels, final=np.zeros(0), **settings)


def fallen(model, at=1.0):
    return walking(model, status="fell", message=f"humanoid fell at {at} s", end_time=at)
