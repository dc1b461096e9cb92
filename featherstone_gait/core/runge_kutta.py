"""The classical Runge-Kutta method of order 4 on the scene's differential equation."""

from .derivative import derivative
from .jit import kernel
from .knots import inputs
from .lanes import sqrt


@kernel
def rk4_step(scene, floating, o, y, t, h, stages, signals, W, Z, C, F):
    """Move y over the step h; stages (3, o.voltage): start, slope and weighted sum."""
    start, slope, total = stages[0], stages[1], stages[2]
    n = o.voltage
    for i in range(n):
        start[i] = y[i]
    for k in range(4):
        inputs(signals, t + 0.5 * h * ((k + 1) // 2))
        derivative(
            scene,
            scene.points,
            scene.push,
            floating,
            o,
            y,
            t,
            h,
            slope,
            signals.tau,
            signals.drive,
            W,
            Z,
            C,
            F,
        )
        weight = 1.0
        if k == 1 or k == 2:
            weight = 2.0
        ahead = 0.5 * h
        if k == 2:
            ahead = h
        for i in range(n):
            if k == 0:
                total[i] = slope[i]
            else:
                total[i] = total[i] + weight * slope[i]
            y[i] = start[i] + ahead * slope[i]
    for i in range(n):
        y[i] = start[i] + (h / 6.0) * total[i]
    if floating is not None:
        k = o.base_q + 3
        r = 1.0 / sqrt(y[k] * y[k] + y[k + 1] * y[k + 1] + y[k + 2] * y[k + 2] + y[k + 3] * y[k + 3])
        for i in range(4):
            y[k + i] = y[k + i] * r
