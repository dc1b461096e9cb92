"""Energies of a joint: columns of the state's part `energy`, integrals since the start [J].

What goes in is the supply, what comes out the work on the joint.
"""

SUPPLY = 0  # integral of V I
METER = 1  # integral of max(0, V I), the paper's meter
COPPER = 2  # R I^2
DRIVER = 3  # what current limit and slew take: V I - R I^2 - K omega I - L I dI/dt
FRICTION = 4  # viscous and Coulomb friction, at the joint and at the rotor
GEAR = 5  # damping of the gearbox
STOPS = 6  # work done on the joint stops, elastic part included
WORK = 7  # mechanical work on the joint by what drives it
ENERGIES = 8
